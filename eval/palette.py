"""Colours for lines and marks that readers with any colour vision tell apart."""

BLUE, VERMILLION, GREEN, PURPLE, ORANGE, GREY = (
    "#0072b2", "#d55e00", "#009e73", "#b0578f", "#b87d00", "#555555",
)  # fmt: skip
"""Okabe and Ito's palette for readers with any colour vision, the light ones darkened."""

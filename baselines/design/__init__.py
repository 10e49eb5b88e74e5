"""Design of optimal laws: the sampled vehicle on a random track, Riccati equations, predictors."""

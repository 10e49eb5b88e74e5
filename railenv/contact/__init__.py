"""Wheel on rail: profiles, geometry, conicity, normal and creep forces."""

from railenv.contact.profiles import Profile, get_profile, profile_names

__all__ = ["Profile", "get_profile", "profile_names"]

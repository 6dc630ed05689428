"""Learned matching, in a process of its own: torch and the models stay out of the rooms that use its matches."""

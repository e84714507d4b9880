"""Odd inputs by the thousand, each with what is right about it."""

"""Servos without hardware. Ships as product and is the default bus."""

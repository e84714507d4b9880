"""Pololu Maestro servo controllers: what they are told, and a simulated one."""

"""Pololu Maestro servo controllers: their protocol, and a simulated one."""

"""Feetech serial bus servos: STS, SMS and SCS."""

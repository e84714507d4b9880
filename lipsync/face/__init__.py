"""The face model: what a mouth looks like, and what every synthesiser of its motion keeps to."""

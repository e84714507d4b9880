"""The workshop: what measures lipservo and what learns its models. No robot needs it."""

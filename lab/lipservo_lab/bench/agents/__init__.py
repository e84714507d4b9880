"""Agents that work all day: `lipservo bench agent` and `lipservo bench day`."""

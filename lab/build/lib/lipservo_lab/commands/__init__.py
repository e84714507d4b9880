"""The commands of the lab; entry points in `lab/pyproject.toml` add them to `lipservo`."""

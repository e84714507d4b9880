"""The servo health log: written while a face runs, read and judged by `lipservo health`."""

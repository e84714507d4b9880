"""The servo health log: written while a face runs, read and evaluated by `lipservo health`."""

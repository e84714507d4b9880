"""Pictures of motion that `lipservo bench motion` draws."""

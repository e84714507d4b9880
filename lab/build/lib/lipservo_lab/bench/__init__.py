"""What `lipservo bench` measures, prints and draws."""

"""What a face that is watched costs, and how well it is shown: `lipservo bench face`."""

"""What driving servos costs beside dynamixel-sdk and rustypot, and what it withstands: `lipservo bench bus`."""

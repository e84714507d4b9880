"""A bridge beside dynamixel-sdk and rustypot, and what its bus withstands: `lipservo bench bus`."""

"""`lipservo bench sync`: lips against sound, at the encoders."""

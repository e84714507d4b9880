"""The loop that owns the servos: torque, goals, supervision of servos, stops, and the end."""

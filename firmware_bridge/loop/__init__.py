"""The loop that drives the servos: torque, goals, supervision of servos, stops, and the end."""

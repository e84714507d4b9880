"""What servos with registers on a shared serial line have in common, whatever their protocol."""

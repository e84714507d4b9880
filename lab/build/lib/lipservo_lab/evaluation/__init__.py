"""How good the motion is: measures over recorded sentences."""

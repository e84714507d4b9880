"""Commands that build a robot: find, set up, jog and simulate servos, and write a face's YAML."""

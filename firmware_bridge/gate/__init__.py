"""The checks that every goal must pass: limits, braking, rules between joints, tracking."""

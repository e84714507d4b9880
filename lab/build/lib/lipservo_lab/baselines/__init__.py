"""What our methods are compared with: dominance functions, splines, linear regression."""

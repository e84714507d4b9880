"""How good synthesised motion is, beside recorded motion and other methods."""

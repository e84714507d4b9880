"""From video of a talking face to a corpus: pictures, tracked points, their sound. Offline."""

"""Plans of poses, and the trackers and files that bring marker positions."""

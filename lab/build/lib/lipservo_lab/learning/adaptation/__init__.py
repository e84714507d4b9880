"""The network's weights learn one voice: from minutes of it, near what they were. Offline."""

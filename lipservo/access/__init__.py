"""Who may reach a face over TCP: one policy, and its token."""

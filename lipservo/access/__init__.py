"""Access over TCP: the policy for clients, its token, and requests to faces of other computers."""

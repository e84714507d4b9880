"""`lipservo study`: make one, serve it, report it; rehearse it before, and count its raters."""

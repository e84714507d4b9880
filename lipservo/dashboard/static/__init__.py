"""What browsers load: our own JavaScript and styles, no library of anybody's."""

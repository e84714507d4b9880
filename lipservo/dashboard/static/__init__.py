"""Files that browsers load: the project's own JavaScript and styles, without other libraries."""

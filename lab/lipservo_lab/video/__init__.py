"""Videos of a talking face become a corpus: faces tracked, sound and picture put in time."""

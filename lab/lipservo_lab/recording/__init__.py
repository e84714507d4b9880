"""A person is recorded while reading sentences: camera and microphone on one clock."""

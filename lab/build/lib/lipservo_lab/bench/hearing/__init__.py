"""What `lipservo bench nonspeech` and `bench recognition` measure of hearing."""

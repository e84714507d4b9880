"""Files that tell phonemes and their times, whoever wrote them: one reader a format."""

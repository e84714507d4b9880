"""Speech becomes face motion: sound, phonemes, face frames.

The first half of the street. Knows no servo and reads no YAML.
"""

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())

"""Turn speech into face motion: sound to phonemes to face frames.

The first half of the pipeline; no module of it uses servos or reads a robot's YAML.
"""

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())

"""`lipservo` in a process of its own, with an invented sound card that delivers by itself."""

import sys
import threading
import time

import numpy as np
from fake_sound_card import DEVICES, FakeSoundDevice

BLOCK_S = 0.01


def deliver(card):
    """Noise, loud and soft in turn; as much as has passed of time."""
    rng = np.random.default_rng(0)
    begun_s, n_given = None, 0
    while True:
        time.sleep(BLOCK_S)
        card.now_s = time.monotonic()
        for stream in (each for each in card.inputs if each.active):
            begun_s = begun_s or card.now_s
            while n_given < (card.now_s - begun_s) / BLOCK_S:
                loud = 0.1 if n_given // 40 % 2 else 0.001
                n_samples = round(stream.rate_hz * BLOCK_S)
                stream.deliver(rng.normal(0.0, loud, n_samples), age_s=0.015)
                n_given += 1


if __name__ == "__main__":
    sound_card = FakeSoundDevice(list(DEVICES), (16_000, 48_000), (1, 2))
    sys.modules["sounddevice"] = sound_card
    threading.Thread(target=deliver, args=(sound_card,), daemon=True).start()
    from lipservo.__main__ import main

    main()

"""A face on a tenth of a processor: nobody is accused or killed, what is broken is named."""

import pytest
from lipservo_lab.bench.stops.busy_computer import processor_share
from lipservo_lab.bench.stops.starved_face import play_starved

from lipsync.errors import UserError


@pytest.mark.slow
def test_a_face_that_starves_for_a_minute_accuses_nobody_and_names_what_is_broken():
    try:
        with processor_share("test", 0.1):
            pass
    except UserError as error:
        pytest.skip(str(error))
    outcome = play_starved(1.0, lambda _n_done, _n: None)

    assert (outcome.accused, outcome.killed_starved) == (0, 0), outcome.failures
    assert outcome.jams_named == outcome.jams == 1, outcome.failures
    assert outcome.hung_killed == outcome.held == 1, outcome.failures

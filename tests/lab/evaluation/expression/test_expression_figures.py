"""The figures of a bench, on a source that is known."""

import pytest
from lipservo_lab.evaluation.expression.expression_figures import expression_figures


def test_a_voice_without_a_frame_measures_nothing():
    with pytest.raises(ValueError, match="0 frames"):
        expression_figures(lambda: None, [])

"""Keys of shards: what shapes a stage's bytes is in them."""

import pytest
from farfield.pipeline import STEPS
from farfield.settings import from_mapping
from farfield.stages import Stage
from farfield.steps.model import Inputs, shard_key


@pytest.mark.parametrize(
    "other",
    [{"detail": {"mode": "off"}}, {"visibility": {"rays": 1000}}, {"device": "phone"}, {"scene": {"up": "z"}}],
    ids=str,
)
def test_a_manifest_that_states_other_settings_has_another_key(other):
    step = STEPS[Stage.PLACEMENTDB]
    keys = {
        shard_key(step, Inputs(from_mapping({"budget": "12 calls", **more}), {}, dict.fromkeys(Stage, "0" * 64)), "all")
        for more in ({}, other)
    }
    assert len(keys) == 2

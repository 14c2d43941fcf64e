"""What every test shares: the Hypothesis profile and the engines; strategies live beside it."""

import os

import pytest
from hypothesis import settings

from hpcomp.compositing import composite as reference_composite

# Reproducible by default: a failure in CI fails on every machine. `thorough` looks for new cases.
settings.register_profile("default", deadline=None, derandomize=True, max_examples=100)
settings.register_profile("thorough", deadline=None, print_blob=True, max_examples=3000)
settings.load_profile(os.environ.get("HPCOMP_HYPOTHESIS", "default"))

#: Every implementation of `composite`; a test that takes the fixture runs through each of them.
ENGINES = {"reference": reference_composite}


@pytest.fixture(scope="session", params=list(ENGINES))
def composite(request):
    """`hpcomp.composite`, once per engine. Of the session's scope, as Hypothesis asks."""
    return ENGINES[request.param]

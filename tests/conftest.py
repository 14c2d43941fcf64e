"""What every test file shares: what the plain run leaves out, the Hypothesis profile, the engines."""

import functools
import os
import warnings

import numpy as np
import pytest
from engines import composite_by
from hypothesis import settings
from pairwise import mark_products

from hpcomp.engine import choice as engine

# Some test files compare with colour, whose first import changes how numpy prints, where the examples
# of README are printed as numpy does by itself, and warns of optional packages that nothing here needs.
with np.printoptions(), warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import colour  # noqa: F401

# Reproducible by default: a failure in CI fails on every machine. The plain run takes `quick`, the gate
# `default`, and `sh tests/run.sh --all` takes `many`; `thorough` looks for new cases.
settings.register_profile("default", deadline=None, derandomize=True, max_examples=40)
settings.register_profile("many", settings.get_profile("default"), max_examples=100)
settings.register_profile("quick", settings.get_profile("default"), max_examples=20)
settings.register_profile("thorough", deadline=None, print_blob=True, max_examples=3000)
settings.load_profile(os.environ.get("HPCOMP_HYPOTHESIS", "default"))


#: Whether this is the gate.
NOTHING_IS_SKIPPED = os.environ.get("HPCOMP_TESTS_SKIP") == "nothing"

#: Fixtures that take long to make: tests are slow that need one.
SLOW_FIXTURES = {
    "full_reports",  # the paper's sample at full size
    "machines",  # a cluster of Dask
    "tab",  # a browser
    "wide_slices",  # volumes of 256 slices
}


def runs_twice(item):
    """Whether a test is one of doubles by the kernel: these are the reference's with any engine."""
    parameters = item.callspec.params if hasattr(item, "callspec") else {}
    return parameters.get("composite") == "kernel" and parameters.get("dtype") is np.float64


@pytest.hookimpl(tryfirst=True)  # before what is not wanted is left out
def pytest_collection_modifyitems(items):
    items[:] = [item for item in items if not runs_twice(item)]
    mark_products(items)
    for item in items:
        if SLOW_FIXTURES.intersection(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    """What cannot be tried here fails in the gate, which has all that tests need."""
    report = yield
    if report.skipped and not hasattr(report, "wasxfail") and NOTHING_IS_SKIPPED:
        report.outcome = "failed"
        report.longrepr = f"skipped, and the gate skips nothing: {report.longrepr}"
    return report


@pytest.fixture(scope="session", params=engine.NAMES)
def composite(request):
    """`hpcomp.composite`, once per engine. Of the session's scope, as Hypothesis asks."""
    return functools.partial(composite_by, request.param)

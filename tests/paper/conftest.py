"""What the tests of the paper's experiment share."""

import pytest

from adaptrack.paper import reproduce, training


@pytest.fixture(scope="package", autouse=True)
def little_training():
    """Ceilings of a fifth of the trees, quick runs of a fifth of the epochs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "TREES", 30)
        patch.setitem(reproduce.QUICK_OPTIONS, "nn", {"epochs": 20})
        patch.setitem(reproduce.QUICK_OPTIONS, "anfis", {"epochs": 2})
        yield

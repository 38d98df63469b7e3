"""The faults of `benchmarks/planted_faults.toml` can be planted."""

from pathlib import Path

import pytest
from benchmarks.planted_faults import read_faults

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("fault", read_faults(), ids=lambda fault: f"{fault.number} {fault.file}")
def test_the_line_of_a_planted_fault_stands_in_its_file_once(fault):
    assert fault.line(ROOT) is not None

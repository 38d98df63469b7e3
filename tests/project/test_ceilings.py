"""No room of the package grows beyond its ceiling."""

from benchmarks.code_figures import CEILINGS, count_lines


def test_no_room_has_more_lines_than_its_ceiling_allows(project):
    lines = count_lines(project)
    above = {place: count for place, count in lines.items() if count > CEILINGS.get(place, 0)}
    assert above == {}, "raise a ceiling in benchmarks/code_figures.py with a reason in docs/design.md"

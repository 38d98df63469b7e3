"""No room of the package grows beyond its ceiling, and all together not at all."""

from benchmarks.code_figures import CEILINGS, SOURCE_LINES, count_lines


def test_no_room_has_more_lines_than_its_ceiling_allows(project):
    lines = count_lines(project)
    above = {place: count for place, count in lines.items() if count > CEILINGS.get(place, 0)}
    assert above == {}, "raise a ceiling in benchmarks/code_figures.py with a reason in docs/design.md"


def test_all_rooms_together_have_no_more_lines_than_before(project):
    rooms = {folder.name for folder in (project / "src/adaptrack").iterdir()} | {"adaptrack"}
    lines = sum(count for place, count in count_lines(project).items() if place in rooms)
    assert lines <= SOURCE_LINES

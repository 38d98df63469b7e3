"""What of a page counts as lost on its successor."""

import sys

import pytest
from benchmarks import pages_compared
from benchmarks.pages_compared import missing, numbers


def page(text):
    return f"<html><title>1</title><style>p {{ margin: 2px }}</style><body>{text}<script>3</script></body></html>"


def test_text_and_alternative_texts_count_and_what_nobody_reads_does_not():
    svg = '<svg role="img" aria-label="RMS 0.25 m"><text>99</text></svg>'
    assert set(numbers(page(f"<p>1\u202f234 runs, −0.5 m</p>{svg}"))) == {"1\u202f234", "−0.5", "0.25"}


@pytest.mark.parametrize("kept", ["0.123 m", "0.1234 m", "0.12349 m"])
def test_a_number_with_more_digits_is_the_same_number(kept):
    assert missing(page("0.123 m"), page(kept)) == []


@pytest.mark.parametrize("other", ["0.12 m", "0.1236 m", "12.3 m", "nothing"])
def test_a_number_that_is_gone_or_another_one_is_missing(other):
    assert missing(page("0.123 m"), page(other)) == ["0.123"]


def test_powers_of_ten_are_read():
    assert missing(page("2.42·10⁻⁶"), page("2.42e-06")) == []
    assert missing(page("2.42·10⁻⁶"), page("2.42e-05")) == ["2.42·10⁻⁶"]


def test_a_page_that_is_gone_is_told_and_fails(tmp_path, monkeypatch, capsys):
    for folder in ("before", "after"):
        (tmp_path / folder).mkdir()
    (tmp_path / "before" / "index.html").write_text(page("1.5"))
    monkeypatch.setattr(sys, "argv", ["", str(tmp_path / "before"), str(tmp_path / "after")])
    assert pages_compared.main() == 1
    assert "no such page any more" in capsys.readouterr().out
    (tmp_path / "after" / "index.html").write_text(page("1.50"))
    assert pages_compared.main() == 0

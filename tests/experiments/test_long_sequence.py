"""The steps of a long drive are timed part by part."""

import pytest

from experiments import long_sequence


def test_each_part_has_its_time_and_the_rest_is_one_of_its_own(capsys):
    assert long_sequence.main(["--frames", "25", "--tracks", "8", "--every", "10"]) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = [[float(cell) for cell in line.strip("| ").split("|")] for line in lines if line[2:3].isdigit()]
    assert [row[0] for row in rows] == [10, 20, 25]
    for _, mean, median, slowest, new, _ in rows:
        assert 0.0 < median <= slowest
        assert new > 0.0
        assert mean <= slowest
    assert any(line.startswith("end: ") for line in lines)


def test_an_estimator_that_is_none_is_named():
    with pytest.raises(Exception, match="no_such"):
        long_sequence.main(["--frames", "25", "--estimator", "no_such"])

"""The command over all sets, on a simulated one: what was inspected is compared, and told in both tables."""

import pytest

from experiments import all_sets
from experiments.all_sets import SETS, Set

SIMULATION = {"frames": 25, "tracks_in_view": 12.0}


@pytest.mark.slow
def test_a_set_is_inspected_compared_and_told_of(monkeypatch, capsys, tmp_path):
    one = Set("Simulated", {"simulation": SIMULATION}, {"dead_reckoning": {}, "eks": {}}, common_set_from=[])
    monkeypatch.setattr(all_sets, "SETS", {"made": one})
    assert all_sets.main(["--out", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = [line.split(" | ") for line in lines if line.startswith("| ")]
    by_name = {row[1]: row for row in rows}
    assert "`dead_reckoning`" in by_name
    smoothed = by_name["`eks`"][5:8]
    assert all(float(cell.strip("| ")) > 0.0 for cell in smoothed)
    assert rows[-1][0] == "| Simulated"
    assert rows[-1][1]
    assert (tmp_path / "made" / "inspected.yaml").is_file()


def test_a_set_that_fails_is_passed_over_and_told_by_the_exit_code(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(all_sets, "SETS", {"gone": Set("Gone", {"file": "gone.npz"})})
    assert all_sets.main(["--out", str(tmp_path), "--data-dir", str(tmp_path)]) == 2
    assert "gone.npz" in capsys.readouterr().err


def test_a_set_of_another_name_is_refused(capsys):
    with pytest.raises(SystemExit):
        all_sets.main(["nowhere"])
    assert f"expected one of {', '.join(SETS)}" in capsys.readouterr().err

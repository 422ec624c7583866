"""The cost of a comparison: ratios of parts, with commands that cost nothing."""

from pathlib import Path

from experiments import compare_cost


def test_parts_are_differences_and_ratios_those_to_the_first(monkeypatch):
    cost = {"imports": 1.0, "dead_reckoning": 3.0, "--no-report": 8.0, "page": 10.0}

    def cpu_s(command, code):
        part = "page"
        for known in cost:
            if known in command or (known == "imports" and command[0] == "-c"):
                part = known
                break
        return cost[part] * (0.5 if code.name == "after" else 1.0)

    monkeypatch.setattr(compare_cost, "cpu_s", cpu_s)
    part = compare_cost.measure("tiny", "ekf,isam2", [Path("before"), Path("after")])
    assert [row[1:] for row in part.rows] == [
        ["1.0", "0.5", "0.50"],
        ["2.0", "1.0", "0.50"],
        ["5.0", "2.5", "0.50"],
        ["2.0", "1.0", "0.50"],
        ["10.0", "5.0", "0.50"],
    ]


def test_a_command_is_measured_by_the_code_of_its_folder(tmp_path):
    (tmp_path / "mine.py").write_text("sum(range(200_000))\n", encoding="utf-8")
    assert compare_cost.cpu_s(("-c", "import mine"), tmp_path) >= 0.0

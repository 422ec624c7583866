"""The page of an inspection: whole, of its own, with the evidence of each check and the proposed config."""

import re

import numpy as np
import pytest

from tests.report.test_page import EVIL, Elements
from vislam.inspection.finding import Finding, Inspection, Measured
from vislam.inspection.page import headline, write_inspection

LATE = Measured("late", "s", 0.05, 0.04, np.inf)
FINDINGS = (
    Finding("clock", "fault", EVIL, (LATE,), proposal={"data.repair.clock": {"offset": 0.05}}),
    Finding("duplicated tracks", "ok", "none", counts={"duplicated_frames": 3}),
    Finding("biases", "unclear", "too short", unknown={"noise.bias_mean": EVIL}),
)
SERIES = {
    "tracks_in_view": np.arange(9.0),
    "duplicated_frames": np.array([3]),
    "track_length": np.array([1, 5, 7]),
    "clock_lag": np.linspace(-0.1, 0.1, 5),
    "clock_cost": np.ones(5),
}


@pytest.fixture(scope="module")
def text(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inspection")
    result = Inspection(EVIL, FINDINGS, SERIES)
    return write_inspection(folder, result, synthetic=True, config=f"name: {EVIL}").read_text("utf-8")


def test_the_page_is_whole_safe_and_fetches_nothing(text):
    elements = Elements(text)
    assert not elements.open
    assert "<script>alert" not in text
    assert text.count("alert(1)") >= 4
    assert not re.search("https?:", text)
    assert "default-src 'none'" in text
    assert len(text) < 500_000
    ids = [attributes["id"] for _, attributes in elements.found if "id" in attributes]
    assert len(set(ids)) == len(ids)
    assert {link["href"][1:] for link in elements.all("a") + elements.all("use")} <= set(ids)


def test_each_check_is_beside_its_evidence_and_its_answer(text):
    assert headline(FINDINGS) == ("1 of 3 checks found a fault (clock); the data cannot tell 1 (biases).")
    assert headline(FINDINGS[1:2]) == "0 of 1 checks found a fault."
    assert text.count('href="#figure-tracks"') == 1
    assert text.count('href="#figure-checks"') == 1
    assert "<td>0.05</td><td>0.04</td><td>inf</td><td>s</td>" in text
    assert "data.repair.clock" in text
    assert "duplicated frames" in text
    assert "SIMULATED" in text

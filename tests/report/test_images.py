"""Pictures of a page: bounded in size, marks by fate, only where the tracks are of images."""

import base64
import json
import re

import numpy as np
import pytest

from vislam.base.errors import DataError
from vislam.cli.main import main
from vislam.comparison.results import Results
from vislam.core.strip import HELD_OUT, LEFT_OUT, Strip, strip_path
from vislam.report.images import FATES, pictures_data

pytest.importorskip("cv2")


def strip(**changes):
    jpeg = base64.b64encode(b"\xff\xd8picture").decode()
    values = {
        "width": 56,
        "height": 20,
        "jpeg": (jpeg, jpeg),
        "frame": np.array([0, 3]),
        "picture": np.array([0, 0, 1]),
        "left": np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]),
        "row": np.array([4, LEFT_OUT, 7]),
    }
    return Strip(**{**values, **changes})


def test_rows_become_those_that_are_given():
    found = strip().of_given(np.array([2, 4]), np.array([7]))
    assert found.row.tolist() == [1, LEFT_OUT, HELD_OUT]
    assert strip().of_given(np.array([], int), np.array([], int)).row.tolist() == [LEFT_OUT] * 3


def test_a_strip_is_read_again(tmp_path):
    tracks = tmp_path / "a.npz"
    assert Strip.beside(tracks, frames=4, observations=8) is None
    strip().save(strip_path(tracks))
    found = Strip.beside(tracks, frames=4, observations=8)
    assert found.jpeg == strip().jpeg
    assert np.array_equal(found.left, strip().left)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, r"must be of the tracks in a.npz, got others; remove it"),
        ({"frame": np.array([0, 9])}, r"must be of the tracks in a.npz"),
        ({"jpeg": ("<script>",)}, r"a_strip.npz"),
    ],
)
def test_another_strip_is_one_line(tmp_path, changes, said):
    strip(**changes).save(strip_path(tmp_path / "a.npz"))
    with pytest.raises(DataError, match=said) as caught:
        Strip.beside(tmp_path / "a.npz", frames=9 if changes else 4, observations=5 if not changes else 8)
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A comparison of a rendered drive, by its tracks."""
    from tests.frontend.studio import rendered, write_asl

    patch, out = pytest.MonkeyPatch(), tmp_path_factory.mktemp("results")
    patch.setenv("XDG_CACHE_HOME", str(out / "cache"))
    folder = write_asl(tmp_path_factory.mktemp("run"), rendered(7))
    command = ["compare", "--data", str(folder), "--out", str(out), "--estimators", "stereo_vo,ekf_invariant"]
    assert main(command) == 0
    patch.undo()
    return next(path.parent for path in out.rglob("report.html"))


@pytest.mark.slow
def test_the_page_has_pictures_with_the_fate_of_each_observation(results):
    page = (results / "report.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="pictures-data">(.*?)</script>', page, re.DOTALL).group(1))
    assert [one["frame"] for one in data["pictures"]] == list(range(7))
    assert sum(len(one["jpeg"]) for one in data["pictures"]) < 1.5e6
    assert data["runs"] == ["stereo_vo", "ekf_invariant"]
    letters = ""
    for one in data["pictures"]:
        content = base64.b64decode(one["jpeg"])
        assert content.startswith(b"\xff\xd8")
        assert content.endswith(b"\xff\xd9")
        for fates in one["fate"].values():
            assert len(fates) == len(one["at"]) // 2 > 20
            letters += fates
    assert set(letters) <= set(FATES)
    assert letters.count("f") > 0.3 * len(letters)
    assert letters.count("h") > 0
    assert 'id="figure-disparities"' in page


@pytest.mark.slow
def test_fused_are_those_that_a_run_fused(results):
    found = Results.load(results)
    data = pictures_data(found.record, found.runs)
    for name, run in found.runs.items():
        at = found.record.given.frame == data["pictures"][3]["frame"]
        shown = data["pictures"][3]["fate"][name]
        assert shown.count("f") == int(run.used[at].sum())
        assert shown.count("g") == int((run.gated & ~run.used)[at].sum())


@pytest.mark.slow
def test_in_a_browser_slider_and_run_redraw(results):
    sync_api = pytest.importorskip("playwright.sync_api")
    from tests.report.test_browser import CHROMIUM

    if CHROMIUM is None:
        pytest.skip("no chromium")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1400, "height": 1000})
        errors = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto((results / "report.html").as_uri())
        marks = page.locator("#pictures-overlay > *")
        first, time = marks.count(), page.locator("#pictures-time").inner_text()
        assert first > 20
        page.locator("#pictures-slider").fill("4")
        assert page.locator("#pictures-time").inner_text() != time
        page.locator("#pictures-run").select_option("ekf_invariant")
        assert "ekf_invariant" in page.locator("#pictures-overlay").get_attribute("aria-label")
        assert page.locator("#pictures-image").evaluate("image => image.naturalWidth") == 320
        page.locator("#pictures-marks").click()
        assert not page.locator("#pictures-overlay").is_visible()
        assert page.evaluate("document.documentElement.scrollWidth") <= 1400
        assert errors == []
        browser.close()

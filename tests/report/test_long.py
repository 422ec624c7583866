"""The page of a long sequence: about as large whatever its length, and it says what of it is drawn."""

from dataclasses import replace

import numpy as np
import pytest

from tests.records import altered
from tests.report.conftest import Tiny
from tests.report.long import lengthened, lengthened_record
from vislam.evaluation import evaluate
from vislam.report.page import MOST_EVENTS
from vislam.report.scene import scene_data, scene_note, unpacked


def long(tiny, times):
    runs = {name: lengthened(run, tiny.record, times) for name, run in tiny.runs.items()}
    record = lengthened_record(tiny.record, times)
    results = replace(tiny.results, runs=runs, record=record)
    return Tiny(tiny.folder, results, evaluate(runs, record))


@pytest.fixture(scope="module")
def hundredfold(tiny):
    return long(tiny, 100)


def test_a_scene_of_many_frames_has_the_poses_of_some_and_says_so(hundredfold):
    scene = scene_data(hundredfold.shown)
    stops = unpacked(scene["stop"])
    assert (scene["frames"], len(stops), stops[0], stops[-1]) == (3000, 2000, 0, 2999)
    run = hundredfold.shown.runs["ekf"]
    entry = next(one for one in scene["runs"] if one["name"] == "ekf")
    np.testing.assert_array_equal(unpacked(entry["frame"]), stops)
    assert len(unpacked(entry["position"])) == 3 * len(stops)
    said = scene_note(scene)
    assert "2,000 of 3,000 frames" in said
    drawn, there = entry["landmarks_drawn"], len(run.landmarks)
    assert f"{drawn:,} of {there:,} of ekf" in said


def test_a_short_sequence_is_drawn_whole_and_nothing_is_said_of_it(tiny):
    scene = scene_data(tiny.shown)
    assert unpacked(scene["stop"]).tolist() == list(range(30))
    assert "frames" not in scene_note(scene)


def test_a_run_without_some_of_the_frames_is_where_it_was_last(hundredfold):
    half = hundredfold.shown.runs["ekf"]
    assert np.array_equal(half.frame, np.arange(3000))
    runs = {"ekf": replace(half, frame=half.frame[:1000], stamp=half.stamp[:1000])}
    # Only what the scene reads of frames is shortened: the poses beyond are not asked for.
    scene = scene_data(replace(hundredfold.shown, runs=runs))
    assert unpacked(scene["runs"][0]["frame"]).max() == 999


def test_of_many_events_the_first_are_listed_and_the_rest_counted(tiny, tmp_path):
    lines = tuple(f"event {index}" for index in range(3 * MOST_EVENTS))
    runs = tiny.runs | {"ekf": altered(tiny.runs["ekf"], events=lines)}
    text = tiny.page(tmp_path / "report.html", runs=runs, figures={}, scene={})
    assert f"ekf: {3 * MOST_EVENTS} events" in text
    assert text.count("<li>event ") == MOST_EVENTS
    assert f"The first {MOST_EVENTS}; all are in" in text


@pytest.mark.slow
def test_the_page_of_ten_times_the_frames_is_about_as_large_and_well_below_the_bound(tiny, tmp_path):
    runs = {name: tiny.runs[name] for name in ("dead_reckoning", "ekf")}
    two = replace(tiny, results=replace(tiny.results, runs=runs))
    sizes = []
    for times in (334, 3334):
        text = long(two, times).page(tmp_path / f"{times}.html")
        sizes.append(len(text))
    assert "Of 100,020 frames what can be told apart is drawn" in text
    assert "Lines of the paths are within" in text
    assert "Positions of the reference drawn" in text
    assert "20,000 of" in text
    assert sizes[1] < 1.5 * sizes[0]
    assert sizes[1] < 10e6

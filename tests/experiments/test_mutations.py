"""Faults that are planted to see whether tests catch them."""

import pytest

from experiments.mutations import MUTATIONS, ROOT


@pytest.mark.parametrize("fault", MUTATIONS, ids=lambda fault: fault.name)
def test_there_is_one_place_to_plant_each_fault_and_a_test_that_may_see_it(fault):
    assert (ROOT / fault.file).read_text(encoding="utf-8").count(fault.old) == 1
    assert fault.new != fault.old
    assert fault.tests
    assert all((ROOT / name).exists() for name in fault.tests)


def test_faults_are_called_by_different_names():
    assert len({fault.name for fault in MUTATIONS}) == len(MUTATIONS)

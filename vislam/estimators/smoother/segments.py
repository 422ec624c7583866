"""iSAM2 that stays small on long sequences: what is old is replaced by its marginal until the end.

With each relinearisation GTSAM looks at all variables and all cliques of its tree, whatever of it moves. So a
step grows linearly with the sequence, although nothing of what is old is touched. Variables that rest (they
are not relinearised any more) and share no factor with one that does not are eliminated once and leave: the
rest has the same marginal as before, at the same linearisation point, by the factorisation that the tree
would have had as well (Kaess et al., *iSAM2: Incremental Smoothing and Mapping Using the Bayes Tree*, IJRR
2012, section 3: a sub-tree enters what is above it by the marginal on its separator alone). A variable that
is needed all along, as the first pose by which all are reported, is in that separator. All factors and
linearisation points are kept, and what needs all of them has the whole tree again.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

import gtsam

from vislam.estimators.smoother.keys import is_landmark
from vislam.estimators.smoother.numbered import NumberedTree
from vislam.estimators.smoother.values import only, without

_EVERY = 200
"""Updates between two cuts."""
_TIED = 2
"""Variables that what leaves may be tied to, as a multiple of those that a frame is tied to."""


class Segments:
    """iSAM2 of the newest segment of a sequence, with all that has left it.

    Parameters
    ----------
    parameters : gtsam.ISAM2Params
    cut : bool
        Whether anything leaves.

    Attributes
    ----------
    factors : gtsam.NonlinearFactorGraph
        All factors, by slot; empty where one was taken out.
    """

    def __init__(self, parameters: gtsam.ISAM2Params, *, cut: bool = True) -> None:
        self._cuts = cut
        self._numbered = NumberedTree(parameters)
        self.factors = gtsam.NonlinearFactorGraph()
        # Where those are linearised that have left.
        self._left = gtsam.Values()
        self._updates, self._wait = 0, _EVERY

    @property
    def whole(self) -> bool:
        """Whether nothing has left."""
        return self._left.size() == 0

    def tree(self, keys: Iterable[int]) -> gtsam.ISAM2:
        """Tree that has some variables: that of the newest segment, or the whole one."""
        if not self.whole and not all(map(self._numbered.tree.valueExists, keys)):
            self.join()
        return self._numbered.tree

    def update(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        parameters: gtsam.ISAM2UpdateParams,
        remove: Sequence[int] = (),
    ) -> list[int]:
        """Update the tree; returns the slots of the new factors among all.

        Parameters
        ----------
        graph, values
            New factors, and first values of new variables.
        parameters : gtsam.ISAM2UpdateParams
            All but the factors to remove.
        remove : sequence of int
            Their slots among all.
        """
        if not self.whole:
            known = (key for key in graph.keyVector() if not values.exists(key))
            if any(map(self._left.exists, known)) or not self._numbered.factors.keys() >= set(remove):
                self.join()
        for slot in remove:
            self.factors.remove(slot)
        self.factors.push_back(graph)
        self._updates += 1
        held = [slot for slot in remove if slot in self._numbered.factors]
        return self._numbered.update(graph, values, parameters, held)

    def linearization_point(self) -> gtsam.Values:
        """Where the factors were linearised last."""
        if self.whole:
            return self._numbered.tree.getLinearizationPoint()
        found = gtsam.Values(self._left)
        found.insert(self._numbered.tree.getLinearizationPoint())
        return found

    def cut(
        self, resting: Collection[int], last: gtsam.KeyGroupMap, lasting: Collection[int] = frozenset()
    ) -> bool:
        """Let leave what may, now and then, and say whether anything did.

        Parameters
        ----------
        resting : collection of int
            Variables that are not relinearised.
        last : gtsam.KeyGroupMap
            What is eliminated last.
        lasting : collection of int
            Those of the resting variables that are needed all along.
        """
        if not self._cuts or self._updates < self._wait:
            return False
        keys = {slot: factor.keys() for slot, factor in self._numbered.factors.items()}
        leaving = _leaving(keys, resting, {slot for slot in keys if slot < 0}, lasting)
        if 2 * len(leaving) < len(set().union(*keys.values())):
            # Long tracks, or errors that all observations share: looked at again after twice the time.
            self._wait = 2 * self._updates
            return False
        inside = self._numbered.touching(leaving)
        tied = set().union(*(keys[slot] for slot in inside)) - leaving
        if len(tied) > _TIED * (last.size() + 1):
            # Their marginal would be one dense factor of all these: landmarks that come back are tied to
            # poses of all times.
            self._wait = 2 * self._updates
            return False
        point = self._numbered.tree.getLinearizationPoint()
        try:
            graph = {slot: factor for slot, factor in self._numbered.factors.items() if slot not in inside}
            graph |= self._numbered.marginal(leaving)
            tree = self._numbered.solved(graph, without(point, leaving), last)
        except (RuntimeError, IndexError):
            self._wait = 2 * self._updates
            return False
        self._left.insert(only(point, leaving))
        self._numbered = tree
        self._updates, self._wait = 0, _EVERY
        return True

    def join(self, last: gtsam.KeyGroupMap | None = None) -> None:
        """Bring back all that has left: the whole tree, solved at where its factors were linearised."""
        slots = filter(self.factors.exists, range(self.factors.size()))
        held = {slot: self.factors.at(slot) for slot in slots}
        values = only(self.linearization_point(), self.factors.keyVector())
        self._numbered = self._numbered.solved(held, values, gtsam.KeyGroupMap() if last is None else last)
        self._left = gtsam.Values()
        self._updates = 0

    def held(self, keys: Iterable[int]) -> Iterator[int]:
        """Those of some variables that have not left."""
        return (key for key in keys if not self._left.exists(key))


def _leaving(
    keys: Mapping[int, Sequence[int]],
    resting: Collection[int],
    marginals: Collection[int],
    lasting: Collection[int] = frozenset(),
) -> set[int]:
    """Variables that rest, as do all that they share a factor with.

    A landmark leaves with the last frame that saw it: else those frames would all be tied to each other.
    What lasts stays by itself: what it is tied to leaves, and ties it to what that was tied to.
    """
    stay: set[int] = set()
    for own in keys.values():
        if any(key not in resting for key in own):
            stay.update(own)
    frames = {key for key in stay if not is_landmark(key)}.difference(lasting)
    for slot, own in keys.items():
        if slot not in marginals and not frames.isdisjoint(own):
            stay.update(filter(is_landmark, own))
    return set().union(*keys.values()) - stay.union(lasting)

"""The sections under ``estimators``: a run's name, its estimator, and its options."""

import re
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass as plain_dataclass
from dataclasses import fields, replace
from typing import Any, Literal

from pydantic.dataclasses import dataclass

from vislam.base.errors import ConfigError, DataError, interruption
from vislam.base.fields import STRICT
from vislam.comparison import config as configuration
from vislam.comparison.config import LIST_MAKER, Config, KernelConfig
from vislam.core import estimator
from vislam.core.estimator import Build, Estimator, Problem
from vislam.models import Kernel


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class MemberConfig:
    """Keys of any section under ``estimators`` beside the options of the estimator itself."""

    estimator: str | None = None
    """Which estimator it is, so that two settings of one can be compared; null: the one it is named for."""
    observations: Literal["listed", "all"] = "listed"
    """``listed``: the common observation set, if there is one (``common_set_from``). ``all``: all that the
    repairs left, gated or not as the estimator's own options say."""
    kernel: KernelConfig | Literal["shared"] | None = "shared"
    """``shared``: that of the comparison. Another, or null for none, is for this run alone, whose information
    is then not that of the rest."""


@plain_dataclass(frozen=True)
class Member:
    """One run of a comparison, not yet built.

    Attributes
    ----------
    builder : Build
    options : mapping of str to Any
        The estimator's own.
    takes_all : bool
        Whether it is given all observations where others are given a common observation set.
    kernel : KernelConfig, "shared" or None
        Its own robust kernel, or that of the comparison.
    """

    builder: Build
    options: Mapping[str, Any]
    takes_all: bool
    kernel: KernelConfig | Literal["shared"] | None = "shared"

    def build(self, problem: Problem) -> "Estimator | Unbuilt":
        """Build the estimator; whatever its own code raises on the way, ``sys.exit`` included, is kept.

        Raises
        ------
        ConfigError, DataError
            If its options, or files that they name, cannot be used.
        """
        if self.kernel != "shared":
            own = self.kernel
            problem = replace(problem, kernel=None if own is None else Kernel(own.degrees_of_freedom))
        try:
            return self.builder(problem, deepcopy(dict(self.options)))
        except BaseException as failure:
            if (stopped := interruption(failure)) is not None:
                raise stopped from None
            if isinstance(failure, (ConfigError, DataError)):
                raise
            return Unbuilt(failure)


@plain_dataclass(frozen=True)
class Unbuilt:
    """An estimator that could not be built.

    Attributes
    ----------
    failure : BaseException
        What its code raised.
    """

    failure: BaseException


def members(config: Config) -> dict[str, Member]:
    """Estimators of a comparison by the name of their run, in order; a ConfigError names the key."""
    for name in config.ablation_chain:
        if name not in config.estimators:
            raise ConfigError(
                f"ablation_chain: expected names out of {', '.join(config.estimators)}, got {name}"
            )
    by = config.gates_from
    if by is not None and by not in config.estimators:
        raise ConfigError(f"gates_from: expected a run ({', '.join(config.estimators)}) or null, got {by}")
    found = {name: member(name, section) for name, section in config.estimators.items()}
    for name, one in found.items():
        if one.takes_all and not config.common_set_from:
            raise ConfigError(
                f"estimators.{name}.observations: all are given anyway unless there is common_set_from"
            )
    return found


def list_makers(config: Config, found: Mapping[str, Member]) -> dict[str, Member]:
    """Who decides which observations all are given, by name, in order: runs of the config, or estimators."""
    return {name: found[name] if name in found else _list_maker(name) for name in config.common_set_from}


def _list_maker(name: str) -> Member:
    # The standard one need not finish its map.
    options = {"marginalised_landmarks": "filtered"} if name == LIST_MAKER else {}
    return Member(estimator.find(name, section="common_set_from"), options, takes_all=False)


def member(name: str, section: Mapping[str, Any]) -> Member:
    """One run of a comparison by its name and section; a ConfigError names the key."""
    if not re.fullmatch(r"\w[\w.+-]{0,47}", name):
        raise ConfigError(
            f"estimators.{name[:80]}: expected letters, digits, '_', '.', '+' and '-', at most 48, as files "
            "are named after it"
        )
    shared = {item.name for item in fields(MemberConfig)}
    own = configuration.parse(
        MemberConfig, {key: section[key] for key in shared & section.keys()}, at=f"estimators.{name}"
    )
    options = {key: value for key, value in section.items() if key not in shared}
    builder = estimator.find(own.estimator or name, section=name)
    return Member(builder, options, takes_all=own.observations == "all", kernel=own.kernel)

"""``python -m vislam.inspect``: what is wrong with a recording, from the data alone, and what answers it.

Of a folder of images or a bag it lists what is in it and what would be taken.

Exit codes: 0 done, whatever was found; 2 bad config or data. With ``--strict`` a fault is exit code 3.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vislam.base.errors import ConfigError, DataError
from vislam.cli.command import Parser, add_config_options, answer, begin, overrides
from vislam.cli.recording import add_choice_options, add_front_end_option, choice_of, listed, located
from vislam.datasets.bag_topics import Choice


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    return answer(lambda: _inspect(options), verbose=options.verbose)


def _parser() -> Parser:
    parser = Parser(prog="python -m vislam.inspect", description=__doc__)
    add_config_options(parser, required=False)
    add = parser.add_argument
    add("--file", type=Path, help="a recording in place of a config; its format is told by its content")
    add("--data", type=Path, help="a recording of stereo images, whose tracks are made first and inspected")
    add_choice_options(parser)
    add_front_end_option(parser)
    add("--out", type=Path, default=Path("inspection"), help="folder of the results (default: inspection)")
    add("--write-config", type=Path, metavar="FILE", help="write the config with all that is proposed")
    add("--strict", action="store_true", help="exit with 3 if a fault was found")
    return parser


def _inspect(options: argparse.Namespace) -> int:
    given = [one for one in (options.config, options.file, options.data) if one is not None]
    if len(given) != 1:
        raise ConfigError("one of --config, --file and --data must be given")
    begin(f"inspect {given[0]}")
    from vislam.datasets.images import is_images  # noqa: PLC0415

    # A YAML file is a config, unless --file says that it is a list of images.
    path = given[0]
    if (
        options.data is None
        and is_images(path)
        and (path == options.file or path.suffix not in (".yaml", ".yml"))
    ):
        return _list(path, choice_of(options))
    # Heavy imports follow the parsing, so that --help and a mistyped key answer at once.
    from vislam.base.files import check_writable, write_text  # noqa: PLC0415
    from vislam.cli.console import Terminal  # noqa: PLC0415
    from vislam.comparison import config as configuration  # noqa: PLC0415
    from vislam.comparison.open import open_dataset  # noqa: PLC0415
    from vislam.datasets.find import search_path  # noqa: PLC0415
    from vislam.inspection import inspect_sequence  # noqa: PLC0415
    from vislam.inspection.checks import unrepaired  # noqa: PLC0415
    from vislam.inspection.page import PAGE, write_inspection  # noqa: PLC0415
    from vislam.inspection.written import proposed_config  # noqa: PLC0415

    home = None if options.config is None else options.config.parent
    tree = _tree_of(options)
    for dotted, value in overrides(options).items():
        configuration.put(tree, dotted, value)
    config = configuration.parse(configuration.Config, tree)
    for path in (options.out / "inspection.json", options.out / PAGE, options.write_config):
        if path is not None:
            check_writable(path)
    terminal = Terminal()
    dataset = open_dataset(
        unrepaired(config).data,
        seed=config.seed,
        data_dir=options.data_dir,
        config_dir=home,
        allow_substitute=not options.no_substitute,
    )
    if dataset.sequence.synthetic:
        terminal.note(dataset.notes[0])
    if dataset.sequence.observations == 0:
        raise DataError(f"{dataset.sequence.name}: no stereo observation is in it")
    result = inspect_sequence(dataset.sequence, config)
    for finding in result.findings:
        terminal.note(f"{finding.verdict.upper():8}{finding.check}: {finding.text}")
    folders = search_path(options.data_dir, config_dir=home)
    target = options.write_config or options.out / "config.yaml"
    text = proposed_config(tree, result, folders=folders, written_to=target)
    again = (options.out / "inspection.json").exists()
    page = write_inspection(options.out, result, synthetic=dataset.sequence.synthetic, config=text)
    terminal.note(f"{'overwritten' if again else 'written'}: {options.out / 'inspection.json'} and figures")
    terminal.note(f"page: {page}")
    if result.proposal:
        terminal.note("proposed:")
        for dotted, value in result.proposal.items():
            terminal.note(f"  {dotted}: {configuration.inline(value)}")
    if options.write_config is not None:
        write_text(options.write_config, text)
        terminal.note(f"config: {options.write_config}")
    return 3 if options.strict and any(item.verdict == "fault" for item in result.findings) else 0


def _tree_of(options: argparse.Namespace) -> dict[str, Any]:
    """Config of what is inspected, as plain data."""
    if options.data is not None:
        from vislam.cli.own_data import tracked_tree  # noqa: PLC0415

        return tracked_tree(
            located(options.data), out=options.out, choice=choice_of(options), front_end=options.front_end
        )
    if options.config is not None:
        from vislam.comparison import config as configuration  # noqa: PLC0415

        return configuration.read(options.config)
    return _tree(options.file, options.data_dir)


def _list(path: Path, choice: Choice) -> int:
    """List what is in a recording of images."""
    from vislam.cli.console import Terminal  # noqa: PLC0415

    terminal = Terminal()
    for line in listed(path, choice):
        terminal.note(line)
    return 0


def _tree(file: Path, data_dir: Path | None) -> dict[str, Any]:
    """Config of a bare file, found where a config would find it."""
    from vislam.datasets.find import find_file, not_found, search_path  # noqa: PLC0415
    from vislam.inspection.checks import bare_tree  # noqa: PLC0415

    # Beside --data-dir a file is where the command line says; a bare name is looked for as a config's is.
    folders = [*([] if data_dir is None else [data_dir]), Path(), *search_path(data_dir)]
    found = find_file(str(file), folders)
    if found is None:
        raise DataError(not_found(str(file), folders))
    return bare_tree(file.stem, str(found.resolve()))


if __name__ == "__main__":
    sys.exit(main())

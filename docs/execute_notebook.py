"""Executes the notebooks of the documentation in their place: ``python docs/execute_notebook.py``."""

import os
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

HERE = Path(__file__).parent
NOTEBOOKS = HERE / "notebooks"


def execute(path: Path) -> nbformat.NotebookNode:
    """Execute a notebook; returns it with its outputs and nothing of the machine."""
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(path.parent)}}).execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
    notebook.metadata = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    return notebook


def main() -> int:
    """Execute all of them and write them with their outputs."""
    # The kernel finds this checkout, whatever is installed.
    os.environ["PYTHONPATH"] = os.pathsep.join([str(HERE.parent), os.environ.get("PYTHONPATH", "")])
    # Figures are drawn into the notebook, whatever backend the shell has set.
    os.environ.pop("MPLBACKEND", None)
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        nbformat.write(execute(path), path)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The notebook runs from the first cell to the last."""

from pathlib import Path

import nbformat
from nbclient import NotebookClient


def test_the_notebook_maps_a_video_and_plots_its_roc(monkeypatch):
    monkeypatch.setenv("MONOGRID_FRAMES", "120")
    monkeypatch.setenv("MONOGRID_SIZE", "320x240")
    notebook = nbformat.read(Path(__file__).parents[1] / "notebooks" / "roc.ipynb", as_version=4)
    NotebookClient(notebook, timeout=600).execute()
    pictures = [o for cell in notebook.cells for o in cell.get("outputs", []) if "image/png" in o.get("data", {})]
    assert len(pictures) == 2

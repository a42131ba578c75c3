"""The asset `signal_plots`: a picture of each signal of a recording.

Files: `<signal>.jpg`, and the same below `inline/`, small enough for reports; `facts.json` lists them.
"""

from dataclasses import dataclass

import numpy as np

from bagassets.assets.asset import Asset, Facts, Inputs, Summary, Use
from bagassets.assets.face import Face, Picture
from bagassets.assets.pictures.canvas import jpeg, jpeg_within
from bagassets.assets.pictures.plot import signal_plot
from bagassets.assets.preview import FACTS, INLINE_BYTES, INLINE_WIDTH_PX
from bagassets.assets.signals import FACTS as SIGNAL_FACTS
from bagassets.assets.signals import SIGNALS, TABLE
from bagassets.recipe.model import Recipe, Rig
from bagassets.recipe.model_signals import STAMP
from bagassets.store.artifact import Artifact, ArtifactWriter


@dataclass(frozen=True)
class PlotParams:
    """What shapes the pictures besides the signals: their width in pixels."""

    width: int

    @classmethod
    def of(cls, recipe: Recipe, _: Rig) -> "PlotParams":
        """Return those of a recipe."""
        return cls(recipe.preview.width)


def use(params: PlotParams, facts: Facts) -> dict[str, Use[PlotParams]]:
    """Return what the pictures of a recording depend on: its signals."""
    signals = facts.channels(SIGNALS.name)
    return {"": Use(params, inputs={f"signal:{name}": one.digest for name, one in signals.items()})}


def make(use: Use[PlotParams], inputs: Inputs, out: ArtifactWriter) -> Summary:
    """Draw the pictures, all over the time of all signals; return the summary."""
    signals = inputs.channels(SIGNALS.name)
    tables = {name: artifact.read_table(TABLE) for name, artifact in sorted(signals.items())}
    ends = [int(table.column(STAMP).to_numpy()[end]) for table in tables.values() for end in (0, -1)]
    span_ns = min(ends, default=0), max(ends, default=0)
    for name, table in tables.items():
        facts = signals[name].read_json(SIGNAL_FACTS)
        title = f"{name} ({facts['topic']})" + (f", {facts['unit']}" if facts["unit"] else "")
        stamps_ns = table.column(STAMP).to_numpy()
        elements = {one: table.column(one).to_numpy().astype(np.float64) for one in table.column_names[1:]}
        whole, small = (
            signal_plot(title, stamps_ns, elements, span_ns, width)
            for width in (use.params.width, INLINE_WIDTH_PX)
        )
        out.write(f"{name}.jpg", jpeg(whole))
        out.write(f"inline/{name}.jpg", jpeg_within(small, INLINE_BYTES, INLINE_WIDTH_PX))
    summary = {"pictures": list(tables)}
    out.write_json(FACTS, summary)
    return summary


def _pictures(artifact: Artifact) -> list[Picture]:
    names = artifact.read_json(FACTS)["pictures"]
    return [Picture(name, f"Signal {name}", f"{name}.jpg", f"inline/{name}.jpg") for name in names]


SIGNAL_PLOTS = Asset(
    name="signal_plots",
    version=1,
    libraries=("opencv-python-headless",),
    title="A plot of each signal over time; the small ones are shown with each materialization.",
    kinds=frozenset({"image"}),
    face=Face(pictures=_pictures),
    reads=(SIGNALS,),
    enabled=lambda recipe: recipe.preview.enabled,
    optional=True,
    params=PlotParams.of,
    use=use,
    make=make,
)

"""Draw docs/pictures/architecture.svg: how recordings become datasets.

    python scripts/architecture.py          # a picture for light pages and one for dark pages

The assets, their order and what they read are those of the code; `bagassets_tests/project/test_architecture.py` compares the pictures.
"""

from dataclasses import dataclass
from html import escape
from pathlib import Path
from textwrap import shorten

from bagassets.formats.catalogue import formats, known_assets

PICTURES = Path(__file__).parents[1] / "docs" / "pictures"

WIDTH, HEIGHT = 1240, 664
BOX_W, BOX_H, STACK = 148, 50, 8
COLUMN_W, ROW_H = 182, 80
SANS = "font-family=\"-apple-system,'Segoe UI','Noto Sans',Helvetica,Arial,sans-serif\""
MONO = "font-family=\"ui-monospace,SFMono-Regular,'DejaVu Sans Mono',Menlo,Consolas,monospace\""

# What assets are, in two or three words; others are shown with the beginning of their titles.
ABOUT = {
    "inventory": "topics, digest of each",
    "signals": "series of numbers",
    "signal_plots": "a picture of each",
    "calibration": "extrinsics, lenses",
    "ego_poses": "where the vehicle was",
    "annotations": "boxes and tracks",
    "frames": "images of each camera",
    "sweeps": "points of each sensor",
    "nuscenes_tables": "scenes and keyframes",
    "vision_sequences": "image sequences",
    "preview": "pictures to look at",
}
# From top to bottom; assets that are not listed here come last.
ORDER = ("ego_poses", "calibration", "frames", "sweeps", "annotations", "vision_sequences", "nuscenes_tables")


@dataclass(frozen=True)
class Theme:
    """Colours of a picture."""

    suffix: str
    text: str
    soft: str
    line: str
    panel: str
    box: str
    blue: str
    green: str
    amber: str


THEMES = (
    Theme("", "#1f2328", "#59636e", "#8c959f", "#f6f8fa", "#ffffff", "#0969da", "#1a7f37", "#9a6700"),
    Theme("-dark", "#f0f6fc", "#9198a1", "#6e7681", "#151b23", "#0d1117", "#4493f8", "#3fb950", "#d29922"),
)


def ranks() -> dict[str, int]:
    """Return the column of each asset: one to the right of all that it reads."""
    found: dict[str, int] = {}
    for asset in known_assets():  # each after those it reads
        found[asset.name] = 1 + max((found[one.name] for one in asset.reads), default=-1)
    return found


def edges() -> list[tuple[str, str]]:
    """Return which asset reads which, without what follows from the others."""
    reads = {asset.name: {one.name for one in asset.reads} for asset in known_assets()}

    def upstream(name: str) -> set[str]:
        return reads[name].union(*map(upstream, reads[name]))

    return [
        (source, name)
        for name, direct in reads.items()
        for source in sorted(direct)
        if not any(source in upstream(other) for other in direct)
    ]


class Picture:
    """An SVG under construction."""

    def __init__(self, theme: Theme) -> None:
        self.theme = theme
        self.parts: list[str] = []

    def box(self, x: float, y: float, w: float, h: float, stroke: str, fill: str, extra: str = "") -> None:
        """Add a rounded rectangle."""
        self.parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{w:g}" height="{h:g}" rx="8" fill="{fill}" stroke="{stroke}"{extra}/>'
        )

    def text(
        self, x: float, y: float, words: str, *, size: int = 13, fill: str = "", font: str = SANS,
        anchor: str = "middle", weight: int = 400,
    ) -> None:  # fmt: skip
        """Add a line of text."""
        self.parts.append(
            f'<text x="{x:g}" y="{y:g}" {font} font-size="{size}" font-weight="{weight}" text-anchor="{anchor}" '
            f'fill="{fill or self.theme.text}">{escape(words)}</text>'
        )

    def arrow(self, path: str, colour: str, extra: str = "") -> None:
        """Add a line with a head."""
        name = {self.theme.line: "line", self.theme.blue: "blue", self.theme.green: "green"}[colour]
        self.parts.append(
            f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="1.6" marker-end="url(#{name})"{extra}/>'
        )

    def asset(self, x: float, y: float, name: str, about: str, stroke: str, *, stacked: bool = False) -> None:
        """Add the box of an asset; a stack if it has one artifact per channel."""
        for offset in (STACK, STACK / 2, 0) if stacked else (0,):
            self.box(x + offset, y - offset, BOX_W, BOX_H, stroke, self.theme.box, ' stroke-width="1.4"')
        self.text(x + BOX_W / 2, y + 21, name, size=14, font=MONO, weight=600)
        self.text(x + BOX_W / 2, y + 39, about, size=12, fill=self.theme.soft)

    def svg(self) -> str:
        """Return the file."""
        heads = "".join(
            f'<marker id="{name}" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" orient="auto">'
            f'<path d="M0 0L10 5L0 10z" fill="{colour}"/></marker>'
            for name, colour in (
                ("line", self.theme.line),
                ("blue", self.theme.blue),
                ("green", self.theme.green),
            )
        )
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img">\n'
            f"<title>How recordings become datasets</title>\n<defs>{heads}</defs>\n"
            + "\n".join(self.parts)
            + "\n</svg>\n"
        )


def draw(theme: Theme) -> str:
    """Return the picture as SVG."""
    picture = Picture(theme)
    _ways_in(picture)
    _dagster(picture)
    _sources(picture)
    places = _places()
    _assets(picture, places)
    _datasets(picture, places)
    _store(picture)
    return picture.svg()


def _ways_in(picture: Picture) -> None:
    """The three ways to start a build, above Dagster."""
    ways = ("bagassets build", "sensor (bagassets ui)", "dagster asset materialize")
    x = 218.0
    for words in ways:
        width = 8.5 * len(words) + 28
        picture.box(x, 12, width, 34, picture.theme.amber, picture.theme.box, ' stroke-width="1.4"')
        picture.text(x + width / 2, 34, words, size=14, font=MONO)
        picture.arrow(f"M{x + width / 2:g} 46V70", picture.theme.line)
        x += width + 16
    for y, words in (
        (26, "build and sensor request runs of what is stale,"),
        (44, "materialize runs what you name"),
    ):
        picture.text(x + 4, y, words, size=13, fill=picture.theme.soft, anchor="start")


def _dagster(picture: Picture) -> None:
    """The frame around all assets, and its two groups."""
    theme = picture.theme
    picture.box(204, 74, 1024, 376, theme.line, "none", ' stroke-width="1.4" stroke-dasharray="6 5"')
    picture.text(220, 97, "Dagster", size=15, weight=600, anchor="start")
    words = "assets, runs, data versions, checks, history, web UI"
    picture.text(286, 97, words, size=13, fill=theme.soft, anchor="start")
    for x, width, title, about in (
        (216, 736, "recording", "once per recording: a partition"),
        (968, 248, "dataset", "once"),
    ):
        picture.box(x, 112, width, 326, "none", theme.panel)
        picture.text(x + 14, 134, title, size=14, weight=600, anchor="start")
        about_x = x + 26 + 8 * len(title)
        picture.text(about_x, 134, about, size=13, fill=theme.soft, anchor="start")


def _sources(picture: Picture) -> None:
    """Recordings and the recipe, on the left."""
    theme = picture.theme
    picture.text(94, 97, "recordings", size=15, weight=600)
    for row, (name, kind) in enumerate(
        (("drive_1.bag", "ROS 1"), ("drive_3/", "ROS 2"), ("drive_5.mcap", "MCAP"))
    ):
        y = 112 + 62 * row
        picture.box(16, y, 156, 50, theme.blue, theme.box, ' stroke-width="1.4"')
        picture.text(94, y + 21, name, size=14, font=MONO, weight=600)
        picture.text(94, y + 39, kind, size=12, fill=theme.soft)
    picture.text(94, 318, "named by the digest", size=12, fill=theme.soft)
    picture.text(94, 334, "of their content", size=12, fill=theme.soft)
    picture.box(16, 530, 156, 50, theme.amber, theme.box, ' stroke-width="1.4"')
    picture.text(94, 551, "recipe.yaml", size=14, font=MONO, weight=600)
    picture.text(94, 569, "channels, poses, scenes", size=12, fill=theme.soft)
    picture.arrow("M172 555H202", theme.line)


def _places() -> dict[str, tuple[float, float]]:
    """Return where the box of each asset is: a column per rank, centred."""
    columns: dict[int, list[str]] = {}
    rank = ranks()
    for name in sorted(rank, key=lambda one: ORDER.index(one) if one in ORDER else len(ORDER)):
        columns.setdefault(rank[name], []).append(name)
    return {
        name: (230 + COLUMN_W * column, 292 + ROW_H * (row - (len(names) - 1) / 2) - BOX_H / 2)
        for column, names in columns.items()
        for row, name in enumerate(names)
    }


def _assets(picture: Picture, places: dict[str, tuple[float, float]]) -> None:
    """The assets of a recording, and which reads which."""
    theme, (x, y) = picture.theme, places["inventory"]
    stacks = {asset.name for asset in known_assets() if asset.extract is not None}
    for row in range(3):
        picture.arrow(_curve(172, 137 + 62 * row, x, y + BOX_H / 2), theme.blue)
    for source, target in edges():
        (x1, y1), (x2, y2) = places[source], places[target]
        # A line that skips columns runs between their boxes.
        turn = (
            x2 - COLUMN_W + BOX_W + STACK if x2 - x1 > COLUMN_W else x1 + BOX_W + STACK * (source in stacks)
        )
        curve = _curve(turn, y1 + BOX_H / 2, x2, y2 + BOX_H / 2)
        picture.arrow(f"M{x1 + BOX_W:g} {y1 + BOX_H / 2:g}H{turn:g}{curve[curve.index('C') :]}", theme.line)
    for asset in known_assets():
        stacked = asset.name in stacks
        about = ABOUT.get(asset.name) or shorten(asset.title.rstrip("."), 24, placeholder="…")
        picture.asset(*places[asset.name], asset.name, about, theme.green, stacked=stacked)


def _datasets(picture: Picture, places: dict[str, tuple[float, float]]) -> None:
    """The datasets, each beside the asset that it is made from."""
    theme = picture.theme
    for kind in formats():
        x, y = places[kind.part]
        picture.arrow(f"M{x + BOX_W:g} {y + BOX_H / 2:g}H1014", theme.line)
        picture.asset(1018, y, f"{kind.name}_dataset", "tables, and links" if kind.name == "nuscenes" else "folders of links", theme.blue)  # fmt: skip
    x, y = places["preview"]
    picture.text(1018 + BOX_W / 2, y + 12, "of all recordings that the", size=12, fill=theme.soft)
    picture.text(1018 + BOX_W / 2, y + 28, "recipe selects; a lock file", size=12, fill=theme.soft)
    picture.text(1018 + BOX_W / 2, y + 44, "lists every artifact", size=12, fill=theme.soft)


def _store(picture: Picture) -> None:
    """What an action is, and where artifacts are."""
    theme = picture.theme
    picture.box(204, 498, 1024, 156, theme.line, theme.panel)
    picture.text(220, 522, "artifact store", size=15, weight=600, anchor="start")
    words = "a known action is never run again; a new one leaves an artifact that is never changed"
    picture.text(326, 522, words, size=13, fill=theme.soft, anchor="start")
    terms = (
        "version of step and libraries",
        "recipe fields it uses",
        "digests of topics and artifacts it reads",
    )
    x = 220.0
    for number, words in enumerate(terms):
        width = 6.6 * len(words) + 22
        picture.box(x, 540, width, 34, theme.line, theme.box)
        picture.text(x + width / 2, 562, words, size=13)
        x += width
        if number < len(terms) - 1:
            picture.text(x + 12, 562, "+", size=16, fill=theme.soft)
            x += 24
    picture.arrow(f"M{x:g} 557H{x + 36:g}", theme.line)
    picture.box(x + 40, 540, 110, 34, theme.green, theme.box, ' stroke-width="1.4"')
    picture.text(x + 95, 562, "action digest", size=13, weight=600)
    picture.arrow(f"M{x + 95:g} 574V604", theme.line)
    picture.box(x + 15, 606, 160, 36, theme.green, theme.box, ' stroke-width="1.4"')
    picture.text(x + 95, 629, "artifact: files, digest", size=13, weight=600)
    picture.text(x, 629, "images, points, Parquet, JSON: each once, named by what it contains", size=13, fill=theme.soft, anchor="end")  # fmt: skip
    picture.arrow("M520 438V494", theme.green)
    picture.text(530, 478, "look up, else make", size=13, fill=theme.soft, anchor="start")
    picture.arrow("M1092 498V442", theme.green)
    picture.text(1082, 478, "hard links", size=13, fill=theme.soft, anchor="end")


def _curve(x1: float, y1: float, x2: float, y2: float) -> str:
    """Return a path that leaves and arrives horizontally."""
    middle = (x1 + x2) / 2
    return f"M{x1:g} {y1:g}C{middle:g} {y1:g} {middle:g} {y2:g} {x2 - 4:g} {y2:g}"


def main() -> None:
    """Write the pictures."""
    for theme in THEMES:
        path = PICTURES / f"architecture{theme.suffix}.svg"
        path.write_text(draw(theme), encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()

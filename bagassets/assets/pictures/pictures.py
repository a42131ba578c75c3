"""The pictures of a recording and the moments that they show: each is drawn from its readings, or has a reason why it cannot be."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil

import numpy as np

from bagassets.assets.boxes.table import BoxTable
from bagassets.assets.boxes.tracks import messages_of, tracks_of
from bagassets.assets.pictures.birds_eye import BoxAt, birds_eye
from bagassets.assets.pictures.canvas import BACKGROUND, DIM, Image, blank, scaled_to, text
from bagassets.assets.pictures.channels import CameraImages, Clouds, View
from bagassets.assets.pictures.over_camera import future_trajectory, lidar_over_camera
from bagassets.assets.pictures.timeline import timeline
from bagassets.assets.timeline.keyframes import Stamps, partner_readings
from bagassets.base.json_types import JsonMapping
from bagassets.geometry.se3 import SE3, Floats
from bagassets.geometry.trajectory import Trajectory

TITLES = {
    "lidar_over_camera": "Lidar over camera",
    "birds_eye": "Bird's-eye view",
    "future_trajectory": "Way ahead",
    "contact_sheet": "Cameras over time",
    "timeline": "Topics over time",
}

_TOLERANCE_NS = 150_000_000
_BOX_GAP_NS, _BOX_TOLERANCE_NS = 1_000_000_000, 250_000_000
_FUTURE_STEP_NS = 100_000_000
_MOST_PAST_POSES = 2000
_LEAST_RANGE_M, _MOST_RANGE_M = 2.0, 200.0
_EMPTY_RANGE_M = 50.0  # where there are no points


class CannotDrawError(Exception):
    """A picture cannot be drawn for this recording; the text is the reason."""


@dataclass(frozen=True)
class Style:
    """How pictures are drawn; see `preview` in the recipe.

    Attributes:
        columns: number of moments on the contact sheet.
        width: of the pictures in pixels.
        future_s: duration of the future trajectory.
        range_m: half the side of the bird's-eye view; None to fit the points.
    """

    columns: int
    width: int
    future_s: float
    range_m: float | None


@dataclass(frozen=True)
class Pictures:
    """The data that pictures of one recording are drawn from.

    Attributes:
        cameras: channel -> images; the first camera is the one in single pictures.
        clouds: revolutions of the lidar in pictures, if there is one.
        trajectory: `global_SE3_ego`.
        boxes: annotations in the global frame.
        timeline_facts: from `timeline_facts`.
        style: how they are drawn.
    """

    cameras: Mapping[str, CameraImages]
    clouds: Clouds | None
    trajectory: Trajectory
    boxes: BoxTable
    timeline_facts: JsonMapping
    style: Style

    def draw(self, name: str) -> Image:
        """Return one of the pictures in `TITLES`.

        Raises:
            CannotDrawError: the recording lacks what it shows.
        """
        drawers: dict[str, Callable[[], Image]] = {
            "lidar_over_camera": self._lidar_over_camera,
            "birds_eye": self._birds_eye,
            "future_trajectory": self._future_trajectory,
            "contact_sheet": self._contact_sheet,
            "timeline": lambda: timeline(self.timeline_facts, self.style.width),
        }
        return drawers[name]()

    @cached_property
    def moment_ns(self) -> int | None:
        """The moment of the single pictures: a reading of the front camera, else of the lidar."""
        cloud_stamps = [self.clouds.stamps_ns] if self.clouds is not None else []
        future_ns = round(self.style.future_s * 1e9)
        for stamps_ns, others in (
            *((camera.stamps_ns, cloud_stamps) for camera in self.cameras.values()),
            *((stamps, []) for stamps in cloud_stamps),
        ):
            _, _, posed = self.trajectory.at(stamps_ns)
            chosen = stamps_ns[posed] if posed.any() else stamps_ns
            index = best_moment(chosen, others, future_ns, _TOLERANCE_NS)
            if index is not None:
                return int(chosen[index])
        return None

    def _front(self) -> tuple[CameraImages, int]:
        for camera in self.cameras.values():
            if self.moment_ns is not None:
                image = reading_at(camera.stamps_ns, self.moment_ns, 0)
                if image is not None:
                    return camera, image
        raise CannotDrawError("there is no camera with images")

    @cached_property
    def _front_image(self) -> Image:
        """The image of `_front`, which two pictures show: to read it takes as long as to draw one."""
        camera, image = self._front()
        return camera.read(image)

    def _view(self, camera: CameraImages, image: int) -> View:
        view = camera.view(image, self.trajectory)
        if view is None:
            raise CannotDrawError(
                f"{camera.channel} has no intrinsics, or no ego pose at the time of the image"
            )
        return view

    @cached_property
    def _points(self) -> Floats:
        """The revolution of the single pictures, in the global frame."""
        clouds, moment_ns = self.clouds, self.moment_ns
        if clouds is None:
            raise CannotDrawError("there is no lidar")
        index = None if moment_ns is None else reading_at(clouds.stamps_ns, moment_ns, _TOLERANCE_NS)
        if index is None:
            raise CannotDrawError(f"{clouds.channel} has no revolution near the image")
        points = clouds.points_global(index, self.trajectory)
        if points is None:
            raise CannotDrawError(f"there is no ego pose at the time of {clouds.channel}")
        return points

    def _lidar_over_camera(self) -> Image:
        camera, image = self._front()
        points = self._points
        view = self._view(camera, image)
        title = f"{self.clouds.channel if self.clouds else ''} over {camera.title}"
        return lidar_over_camera(self._front_image, points, view, width=self.style.width, title=title)

    def _birds_eye(self) -> Image:
        if self.moment_ns is None:
            raise CannotDrawError("there are neither images nor revolutions")
        global_SE3_ego = self.trajectory.pose_at(self.moment_ns)
        if global_SE3_ego is None:
            raise CannotDrawError("there is no ego pose at the moment of the picture")
        points = np.zeros((0, 3)) if self.clouds is None else self._points
        boxes, past = boxes_at(self.boxes, self.moment_ns), self._past(self.moment_ns)
        if not len(points) and not boxes and not len(past):
            raise CannotDrawError("there are no points, no boxes, and the rig stands still")
        range_m = self.style.range_m or suitable_range_m(points, global_SE3_ego)
        return birds_eye(
            points,
            boxes,
            past,
            global_SE3_ego,
            range_m=range_m,
            width=self.style.width * 3 // 4,
            title=f"+/- {range_m:g} m",
        )

    def _past(self, moment_ns: int) -> Floats:
        track = self.trajectory
        if track.fixed:
            return np.zeros((0, 3))
        past = np.flatnonzero(track.stamps_ns <= moment_ns)
        return track.positions_m[past[:: 1 + len(past) // _MOST_PAST_POSES]]

    def _future_trajectory(self) -> Image:
        if self.trajectory.fixed:
            raise CannotDrawError("the rig stands still")
        camera, image = self._front()
        view = self._view(camera, image)
        start_ns = int(camera.stamps_ns[image])
        stamps_ns = start_ns + np.arange(
            0, round(self.style.future_s * 1e9) + 1, _FUTURE_STEP_NS, dtype=np.int64
        )
        positions, rotations, valid = self.trajectory.at(stamps_ns)
        # Only up to the first moment without a pose, so that the trajectory has no gap.
        known = len(valid) if valid.all() else int(np.argmin(valid))
        return future_trajectory(
            self._front_image,
            positions[:known],
            rotations[:known],
            (stamps_ns[:known] - start_ns) / 1e9,
            view,
            width=self.style.width,
            title=f"{camera.title}: the next {max(known - 1, 0) * _FUTURE_STEP_NS / 1e9:g} s",
        )

    def _contact_sheet(self) -> Image:
        spans = [
            (int(c.stamps_ns[0]), int(c.stamps_ns[-1])) for c in self.cameras.values() if len(c.stamps_ns)
        ]
        if not spans:
            raise CannotDrawError("there is no camera with images")
        first_ns, last_ns = min(start for start, _ in spans), max(end for _, end in spans)
        # A recording with few images shows each of them once.
        columns = min(self.style.columns, max(len(camera.files) for camera in self.cameras.values()))
        moments = evenly_spaced(first_ns, last_ns, columns)
        tolerance_ns = max(_TOLERANCE_NS, (last_ns - first_ns) // (2 * columns))
        tile_width = self.style.width // columns
        tiles: dict[str, list[Image | None]] = {}
        for camera in self.cameras.values():
            found = [reading_at(camera.stamps_ns, moment, tolerance_ns) for moment in moments]
            tiles[camera.title] = [
                None if image is None else camera.read_reduced(image, tile_width) for image in found
            ]
        start_ns = self.timeline_facts["start_ns"] or first_ns
        return contact_sheet(tiles, [(moment - start_ns) / 1e9 for moment in moments], self.style.width)


def suitable_range_m(points_global: Floats, global_SE3_ego: SE3) -> float:
    """Return half the side of a view that shows nine of ten points: 2 to 200 m, a multiple of 1, 5 or 10 m."""
    if not len(points_global):
        return _EMPTY_RANGE_M
    offsets = points_global[:, :2] - np.array(global_SE3_ego.translation[:2])
    apart_m = np.sort(np.abs(offsets).max(axis=1))
    far_m = float(apart_m[int(0.9 * (len(apart_m) - 1))])
    wanted_m = 1.1 * far_m
    step_m = 1.0 if wanted_m <= 10.0 else 5.0 if wanted_m <= 50.0 else 10.0
    return min(max(step_m * ceil(wanted_m / step_m), _LEAST_RANGE_M), _MOST_RANGE_M)


def boxes_at(boxes: BoxTable, moment_ns: int) -> list[BoxAt]:
    """Return the boxes at one moment, chosen and interpolated as for keyframes."""
    moment = np.array([moment_ns], dtype=np.int64)
    found = []

    def show(row: int, pose: SE3) -> None:
        width_m, length_m, _ = (float(v) for v in boxes.sizes_m[row])
        found.append(BoxAt(boxes.categories[row], pose, width_m, length_m))

    for track in tracks_of(boxes):
        at = track.at(moment, _BOX_GAP_NS, _BOX_TOLERANCE_NS)
        if len(at.at):
            show(int(track.rows[at.observations[0]]), SE3.create(at.rotations[0], at.centers_m[0]))
    for messages in messages_of(boxes):
        message = int(messages.at(moment, _BOX_TOLERANCE_NS)[0])
        for row in messages.rows[message].tolist() if message >= 0 else ():
            show(row, SE3.create(boxes.rotations[row], boxes.centers_m[row]))
    return found


def evenly_spaced(first_ns: int, last_ns: int, number: int) -> list[int]:
    """Return moments in the middle of `number` equal parts of a span."""
    span_ns = last_ns - first_ns
    return [first_ns + span_ns * (2 * part + 1) // (2 * number) for part in range(number)]


def reading_at(stamps_ns: Stamps, moment_ns: int, tolerance_ns: int) -> int | None:
    """Return the index of the reading nearest to a moment, or None if it is too far."""
    index = int(partner_readings(np.array([moment_ns], dtype=np.int64), stamps_ns, tolerance_ns)[0])
    return index if index >= 0 else None


def best_moment(
    stamps_ns: Stamps, others_ns: Sequence[Stamps], future_ns: int, tolerance_ns: int
) -> int | None:
    """Return the index of the reading in single pictures.

    It is the one nearest to the middle of the recording that leaves `future_ns` (or half of the recording)
    ahead, among those for which as many of the other channels as possible have a reading.

    Args:
        stamps_ns: (N,) readings to choose from.
        others_ns: stamps of other channels that the picture should show.
        future_ns: duration of the future trajectory.
        tolerance_ns: largest time to a reading of another channel.
    """
    if not len(stamps_ns):
        return None
    accompanied = np.zeros(len(stamps_ns), dtype=np.int64)
    for other in others_ns:
        accompanied += partner_readings(stamps_ns, other, tolerance_ns) >= 0
    candidates = np.flatnonzero(accompanied == accompanied.max())
    first, last = int(stamps_ns[0]), int(stamps_ns[-1])
    wanted = min((first + last) // 2, max(last - future_ns, first + (last - first) // 4))
    return int(candidates[np.argmin(np.abs(stamps_ns[candidates] - wanted))])


GAP_PX = 4
HEADER_PX = 22


def contact_sheet(tiles: Mapping[str, Sequence[Image | None]], seconds: Sequence[float], width: int) -> Image:
    """Return a contact sheet: all cameras over time, with cameras as rows and moments as columns.

    Args:
        tiles: camera -> its image at each moment, None where it has none.
        seconds: time of each moment since the start of the recording.
        width: of the picture in pixels.
    """
    columns = len(seconds)
    tile_width = (width - GAP_PX * (columns + 1)) // columns
    rows = {
        name: [None if image is None else scaled_to(image, tile_width) for image in images]
        for name, images in tiles.items()
    }
    heights = {
        name: max((t.shape[0] for t in row if t is not None), default=24) for name, row in rows.items()
    }
    sheet = blank(width, HEADER_PX + sum(height + GAP_PX for height in heights.values()) + GAP_PX)
    for column, second in enumerate(seconds):
        text(sheet, f"{second:.1f} s", _left(column, tile_width) + 2, 15, size_px=11, colour=DIM)
    top = HEADER_PX
    for name, row in rows.items():
        for column, tile in enumerate(row):
            left = _left(column, tile_width)
            if tile is None:
                text(sheet, "no image", left + 6, top + 16, size_px=10, colour=DIM)
                continue
            sheet[top : top + tile.shape[0], left : left + tile.shape[1]] = tile
        text(sheet, name, GAP_PX + 5, top + 15, size_px=11, halo=True)
        top += heights[name] + GAP_PX
    sheet[:, width - 1] = BACKGROUND
    return sheet


def _left(column: int, tile_width: int) -> int:
    return GAP_PX + column * (tile_width + GAP_PX)

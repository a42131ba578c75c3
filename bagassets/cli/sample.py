"""`bagassets sample`: synthetic drives, for trying things out and for measurements."""

from pathlib import Path

import click

from bagassets.cli.options import Number
from bagassets.cli.terminal import echo

_FORMATS = {".bag": "ros1", ".mcap": "mcap", "": "ros2", ".db3": "ros2"}


@click.command(
    epilog="""\b
Examples:
  bagassets sample drive.mcap
  bagassets sample drive.bag --seed 7 --compression lz4
  bagassets sample big --profile tas --duration 20      # a ROS 2 folder, 90 MB per second
  bagassets sample drive.mcap --odd projection-only     # K of CameraInfo is zero, as rectified cameras send it
  bagassets sample drive.bag --parts 3                  # drive_0.bag, drive_1.bag, drive_2.bag: one recording
  bagassets sample drive.mcap --recipe-out recipe.yaml && bagassets build
  bagassets sample pick.mcap --robot arm --odd camera-stops"""
)
@click.argument("path", type=click.Path(path_type=Path))
@click.option(
    "--format",
    "file_format",
    type=click.Choice(["ros1", "ros2", "mcap", "foxglove"]),
    help="Default: by the suffix: .bag is ros1, .mcap is mcap, none is ros2 (a folder with a database), .db3 its database alone. "
    "foxglove is an MCAP without ROS, of the arm only.",
)
@click.option(
    "--robot",
    type=click.Choice(["car", "arm"]),
    default="car",
    show_default=True,
    help="arm: seven joints and a gripper, their commands, two cameras, tasks and episodes; no calibration.",
)
@click.option(
    "--compression",
    type=click.Choice(["none", "lz4", "bz2", "zstd"]),
    default="none",
    show_default=True,
    help="ros1 supports lz4 and bz2; ros2 zstd; mcap lz4 and zstd.",
)
@click.option(
    "--profile",
    type=click.Choice(["small", "drive", "tas"]),
    default="small",
    show_default=True,
    help="small: 4 s, images of 320x200; drive: 20 s, images of 640x400; tas: 10 s of four 1920x1080 Bayer cameras and the "
    "packets of a 128-beam lidar, with repeating content, for measuring throughput.",
)
@click.option(
    "--seed", type=click.IntRange(0, 10_000), default=0, show_default=True, help="Seed of the world."
)
@click.option(
    "--duration",
    type=Number(0.1, 36_000),
    metavar="S",
    help="Duration in seconds; default: that of the profile.",
)
@click.option(
    "--parts",
    type=click.IntRange(1, 100),
    default=1,
    show_default=True,
    metavar="N",
    help="Split it, as recorders do, into N files of equal length: NAME_0, NAME_1, …; latched messages are in the first.",
)
@click.option(
    "--odd",
    multiple=True,
    metavar="NAME",
    help="Do something that real recordings do; may be repeated. `bagassets docs page tests` lists the oddities.",
)
@click.option(
    "--recipe-out",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Also write a recipe for drives of this profile.",
)
def sample(
    path: Path,
    file_format: str | None,
    robot: str,
    compression: str,
    profile: str,
    seed: int,
    duration: float | None,
    parts: int,
    odd: tuple[str, ...],
    recipe_out: Path | None,
) -> None:
    """Write a synthetic drive with known ground truth.

    A circular road with buildings, vehicles and pedestrians, recorded by three cameras with lens distortion (one Bayer,
    one colour, one JPEG), a spinning lidar and a radar, with odometry, TF, GNSS, IMU, and the true boxes on /annotations.
    With --robot arm, an arm that does its tasks instead. The same seed gives the same recording in every format.
    """
    from bagassets.sample.arm_oddities import ARM_ODDITIES
    from bagassets.sample.drive import PROFILES, Target, write_arm_recordings, write_recordings
    from bagassets.sample.oddities import ODDITIES

    kind = file_format or _FORMATS.get(path.suffix)
    if kind is None:
        raise click.UsageError(
            f"{path}: the suffix names no format; give --format, or a name that ends in .bag or .mcap."
        )
    if parts > 1 and not path.suffix:
        raise click.UsageError(
            f"{path}: a folder is one recording, however many files it has; for parts, end the name in .db3."
        )
    if recipe_out is not None and recipe_out.exists():
        raise click.UsageError(f"{recipe_out}: this file exists and is not overwritten; choose another name.")
    is_arm = robot == "arm"
    known = ARM_ODDITIES if is_arm else ODDITIES
    if unknown := [name for name in odd if name not in known]:
        raise click.UsageError(
            f"no oddity of the {robot} is named {unknown[0]}; known: {', '.join(sorted(known))}."
        )
    if is_arm and PROFILES[profile].throughput:
        raise click.UsageError(f"there is no arm of the profile {profile}; leave --profile out.")
    if kind == "foxglove" and not is_arm:
        raise click.UsageError("only recordings of the arm are written without ROS; add --robot arm.")
    if odd and PROFILES[profile].throughput:
        raise click.UsageError(f"drives of the profile {profile} have no oddities; leave --odd out.")
    length_s = PROFILES[profile].duration_s if duration is None else duration
    with click.progressbar(length=1000, label=f"Writing {path}") as bar:
        write = write_arm_recordings if is_arm else write_recordings
        write(
            [Target(path, kind, compression, parts)],  # type: ignore[arg-type]  # click checked the choices
            seed,
            profile,
            length_s,
            lambda seconds: bar.update(max(0, min(1000, int(1000 * seconds / length_s)) - bar.pos)),
            odd,
        )
    written = path if parts == 1 else path.with_stem(f"{path.stem}_0")
    several = "" if parts == 1 else f" in {parts} parts"
    echo(
        f"Wrote {path}{several}: {length_s:g} s of {'the arm' if is_arm else 'drive'}, seed {seed}. Inspect it: bagassets inspect {written}"
    )
    if recipe_out is not None:
        from bagassets.sample.recipe import arm_recipe, sample_recipe

        root = str(path.resolve().parent)
        if is_arm:
            text = arm_recipe(root=root, foxglove=kind == "foxglove")
        else:
            text = sample_recipe(root=root, throughput=PROFILES[profile].throughput)
        recipe_out.write_text(text, encoding="utf-8")
        echo(f"Wrote {recipe_out}. Build the dataset: bagassets build --recipe {recipe_out}")

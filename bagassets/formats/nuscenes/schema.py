"""The tables of nuScenes v1.0: their columns, which columns refer to which table, and the names of splits."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from bagassets.base.json_types import JsonMapping

SPLITS = "splits.json"
"""File beside the tables that names the scenes of each split."""
# Names that nuscenes-devkit answers itself, with the scenes of nuScenes.
DEVKIT_SPLITS = frozenset({"train", "val", "test", "mini_train", "mini_val", "train_detect", "train_track"})

Row = JsonMapping


@dataclass(frozen=True)
class Table:
    """One table.

    Attributes:
        name: file name without `.json`.
        columns: in the order in which they are written.
        references: column -> table that its token, or each of its tokens, refers to.
        optional: columns of `references` that may be empty.
        shared: written once for the dataset; other tables are joined from the recordings.
    """

    name: str
    columns: tuple[str, ...]
    references: Mapping[str, str] = field(default_factory=dict)
    optional: frozenset[str] = frozenset()
    shared: bool = False


def _table(name: str, columns: str, *, shared: bool = False) -> Table:
    """Return a table; `column:table` is a reference, `column?:table` one that may be empty."""
    names, references, optional = [], {}, set()
    for word in columns.split():
        column, _, target = word.partition(":")
        name_only = column.removesuffix("?")
        names.append(name_only)
        if target:
            references[name_only] = target
        if column != name_only:
            optional.add(name_only)
    return Table(name, tuple(names), MappingProxyType(references), frozenset(optional), shared)


_ALL = (
    _table("category", "token name description", shared=True),
    _table("attribute", "token name description", shared=True),
    _table("visibility", "token level description", shared=True),
    _table("sensor", "token channel modality", shared=True),
    _table("map", "token log_tokens:log category filename", shared=True),
    # `origin` is not in nuScenes: where on Earth the global frame of a recording begins; null if unknown.
    _table("log", "token logfile vehicle date_captured location origin"),
    _table(
        "scene",
        "token log_token:log nbr_samples first_sample_token:sample last_sample_token:sample name description",
    ),
    _table("sample", "token timestamp prev?:sample next?:sample scene_token:scene"),
    _table("calibrated_sensor", "token sensor_token:sensor translation rotation camera_intrinsic"),
    _table("ego_pose", "token timestamp rotation translation"),
    _table(
        "sample_data",
        "token sample_token:sample ego_pose_token:ego_pose calibrated_sensor_token:calibrated_sensor timestamp "
        "fileformat is_key_frame height width filename prev?:sample_data next?:sample_data",
    ),
    _table(
        "instance",
        "token category_token:category nbr_annotations first_annotation_token:sample_annotation "
        "last_annotation_token:sample_annotation",
    ),
    _table(
        "sample_annotation",
        "token sample_token:sample instance_token:instance visibility_token:visibility attribute_tokens:attribute "
        "translation size rotation prev?:sample_annotation next?:sample_annotation num_lidar_pts num_radar_pts",
    ),
)

NAME = "nuscenes"
TABLES: Mapping[str, Table] = MappingProxyType({table.name: table for table in _ALL})
SHARED_TABLES = tuple(table.name for table in _ALL if table.shared)
RECORDING_TABLES = tuple(table.name for table in _ALL if not table.shared)


def devkit_split_name(name: str) -> str:
    """Return the name of a split in `splits.json`.

    The devkit never looks up its own names there, so these get a prefix: `train` becomes `custom_train`.
    """
    return f"custom_{name}" if name in DEVKIT_SPLITS else name

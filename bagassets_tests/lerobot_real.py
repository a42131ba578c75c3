"""Runs in the environment of the real lerobot, which needs another numpy and torch: what it makes of a dataset, as JSON.

`python lerobot_real.py read ROOT`, `stats ROOT IMAGES.json`, `tools ROOT OTHER FOLDER`, `train ROOT`
"""

import importlib.util
import json
import logging
import sys
import warnings
from pathlib import Path

import torch

# The compiled operators of torchvision's wheels may want CUDA, which torch for the processor alone lacks; lerobot's datasets use
# none of them, but importing torchvision names this one.
_VISION = importlib.util.find_spec("torchvision")
try:
    torch.ops.load_library(str(next(Path(str(_VISION.origin)).parent.glob("_C*.so"))))
except OSError:
    _OPERATORS = torch.library.Library("torchvision", "DEF")
    _OPERATORS.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
warnings.filterwarnings("ignore")
logging.disable(logging.WARNING)

import av  # noqa: E402
import lerobot  # noqa: E402
import numpy as np  # noqa: E402
from lerobot.datasets.compute_stats import (  # noqa: E402
    aggregate_stats,
    compute_episode_stats,
    get_feature_stats,
    sample_images,
)
from lerobot.datasets.dataset_tools import delete_episodes, merge_datasets  # noqa: E402
from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: E402

sys.path.insert(0, str(Path(__file__).parent))
from painted_numbers import number_in  # noqa: E402

CAMERA = "observation.images.wrist"
EXACT = ("min", "max", "mean", "std", "count")


def opened(root, name="me/x", **options):
    return LeRobotDataset(name, root=root, video_backend="pyav", **options)


def shown(image):
    """The number in a frame, (3, H, W) in 0..1."""
    return number_in((image.permute(1, 2, 0) * 255).numpy())


def read(root):
    """Return what every frame shows, now and one frame before, and how frames differ from those of PyAV alone."""
    fps = opened(root).fps
    steps = {CAMERA: [-1 / fps, 0.0], "observation.state": [-1 / fps, 0.0], "action": [0.0, 1 / fps]}
    dataset = opened(root, delta_timestamps=steps)
    frames = {}
    for path in sorted(Path(root, "videos", CAMERA).glob("*/*.mp4")):
        with av.open(str(path)) as container:
            frames[str(path)] = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    found = {
        "numbers": [],
        "before": [],
        "states": [],
        "actions": [],
        "episodes": [],
        "tasks": [],
        "most_off": 0,
    }
    for index in range(len(dataset)):
        item = dataset[index]
        episode = dataset.meta.episodes[int(item["episode_index"])]
        found["numbers"].append(shown(item[CAMERA][1]))
        found["before"].append(None if bool(item[f"{CAMERA}_is_pad"][0]) else shown(item[CAMERA][0]))
        found["states"].append(item["observation.state"][1].tolist())
        found["actions"].append(item["action"][0].tolist())
        found["episodes"].append(int(item["episode_index"]))
        found["tasks"].append(item["task"])
        path = str(dataset.root / dataset.meta.get_video_file_path(int(item["episode_index"]), CAMERA))
        place = round(episode[f"videos/{CAMERA}/from_timestamp"] * fps) + int(item["frame_index"])
        ours = frames[path][place].astype(int)
        theirs = (item[CAMERA][1].permute(1, 2, 0) * 255).round().numpy().astype(int)
        found["most_off"] = max(found["most_off"], int(np.abs(ours - theirs).max()))
    found["files"] = len(frames)
    return found


def difference(ours, theirs, names):
    return max(
        float(np.abs(np.asarray(ours[name], float) - np.asarray(theirs[name], float)).max()) for name in names
    )


def stats(root, images):
    """Return how far the statistics of the dataset are from the library's own, computed afresh."""
    dataset = opened(root)
    numeric = {name: one for name, one in dataset.features.items() if one["dtype"] != "video"}
    files = json.loads(Path(images).read_text())
    columns = dataset.hf_dataset.with_format("numpy")
    afresh, rows = [], 0
    for episode in dataset.meta.episodes:
        span = slice(episode["dataset_from_index"], episode["dataset_to_index"])
        data = {name: np.asarray(columns[name][span]) for name in numeric}
        afresh.append(compute_episode_stats(data, numeric))
        rows += len(data["index"])
    whole = aggregate_stats(afresh)
    # As it is, the library squares 8-bit levels in 8 bits: its `std` of images is not one. Given wider ones, the same code is right.
    pixels = [sample_images(some).astype(np.float64) for some in files]
    exact = [get_feature_stats(some, axis=(0, 2, 3), keepdims=True) for some in pixels]
    exact = [
        {k: v if k == "count" else np.squeeze(v / 255.0, axis=0) for k, v in one.items()} for one in exact
    ]
    as_it_is = [compute_episode_stats({CAMERA: some}, {CAMERA: {"dtype": "video"}})[CAMERA] for some in files]
    film = aggregate_stats([{CAMERA: one} for one in exact])[CAMERA]
    return {
        "rows": rows,
        "numeric": {name: difference(dataset.meta.stats[name], whole[name], EXACT) for name in numeric},
        "images": difference(dataset.meta.stats[CAMERA], film, EXACT),
        "their_std_of_images": max(float(one["std"].max()) for one in as_it_is),
        "our_std_of_images": float(np.asarray(dataset.meta.stats[CAMERA]["std"]).max()),
    }


def tools(root, other, folder):
    """Merge two datasets and delete episodes with the library's tools; return what the frames of the results show."""
    one, two = opened(root), opened(other, "me/y")
    merged = merge_datasets([one, two], "me/merged", Path(folder, "merged"))
    fewer = delete_episodes(one, [0, 2], Path(folder, "fewer"), "me/fewer")
    found = {}
    for name, made in (("merged", merged), ("fewer", fewer)):
        again = opened(made.root, f"me/{name}")
        found[name] = [shown(again[index][CAMERA]) for index in range(len(again))]
    return found


def train(root):
    """Take steps of a tiny policy of the library's; return the losses."""
    from lerobot.configs.types import FeatureType

    try:
        from lerobot.utils.feature_utils import dataset_to_policy_features  # since 0.5
    except ImportError:
        from lerobot.datasets.utils import dataset_to_policy_features
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.factory import make_pre_post_processors

    torch.manual_seed(0)
    plain = opened(root)
    features = dataset_to_policy_features(plain.meta.features)
    outputs = {name: one for name, one in features.items() if one.type is FeatureType.ACTION}
    inputs = {name: one for name, one in features.items() if name not in outputs}
    settings = ACTConfig(
        input_features=inputs, output_features=outputs, chunk_size=4, n_action_steps=4, dim_model=32, n_heads=2,
        dim_feedforward=64, n_encoder_layers=1, n_vae_encoder_layers=1, pretrained_backbone_weights=None, device="cpu",
    )  # fmt: skip
    steps = {"action": [n / plain.fps for n in settings.action_delta_indices]}
    policy = ACTPolicy(settings)
    before, _ = make_pre_post_processors(settings, dataset_stats=plain.meta.stats)
    optimizer = torch.optim.AdamW(policy.parameters(), lr=1e-3)
    losses = []
    for batch in torch.utils.data.DataLoader(
        opened(root, delta_timestamps=steps), batch_size=16, shuffle=True
    ):
        loss, _ = policy.forward(before(batch))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss))
    return {"losses": losses}


if __name__ == "__main__":
    command, *arguments = sys.argv[1:]
    result = {"read": read, "stats": stats, "tools": tools, "train": train}[command](*arguments)
    print(json.dumps({"lerobot": lerobot.__version__, **result}))

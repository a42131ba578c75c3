"""What bagassets asks of OpenCV gives the same bytes on every processor: it is called with and without vector units.

Not so, and not used: `addWeighted`, `initUndistortRectifyMap`, `remap` with float maps, `warpAffine`, `INTER_CUBIC`, and on arm64
`INTER_AREA` by parts of pixels (`distanceTransform` differs there in the sixth digit, of which checks print three).
"""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

from bagassets_tests.whole.test_golden import OLD_PROCESSOR

PACKAGE = Path(__file__).parents[2] / "bagassets"
SCRIPT = r"""
import hashlib, json, sys
import cv2
import numpy as np

cv2.setNumThreads(1)
rng = np.random.default_rng(0)
grey, wide = rng.integers(0, 256, (301, 403), np.uint8), rng.integers(0, 65536, (301, 403), np.uint16)
colour = rng.integers(0, 256, (301, 403, 3), np.uint8)
bgra = cv2.cvtColor(colour, cv2.COLOR_BGR2BGRA)
xy = rng.integers(-3, 400, (301, 403, 2)).astype(np.int16)
fraction = rng.integers(0, 1024, (301, 403)).astype(np.uint16)
corners = (rng.random((7, 2)) * 300 * 16).astype(np.int32)
jpeg, png = (cv2.imencode(kind, colour)[1] for kind in (".jpg", ".png"))


def drawn(draw, *arguments):
    canvas = colour.copy()
    draw(canvas, *arguments)
    return [canvas]


made = {
    "applyColorMap": [cv2.applyColorMap(grey, cv2.COLORMAP_TURBO)],
    "circle": drawn(cv2.circle, (90, 80), 33, (255, 9, 99), 3, cv2.LINE_AA),
    "copyMakeBorder": [cv2.copyMakeBorder(colour, 0, 2, 0, 1, cv2.BORDER_REPLICATE)],
    "cvtColor": [
        *(cv2.cvtColor(one, getattr(cv2, f"COLOR_Bayer{order}2BGR"))
          for one in (grey, wide) for order in ("BG", "GB", "RG", "GR")),
        *(cv2.cvtColor(grey, getattr(cv2, f"COLOR_Bayer{order}2BGRA")) for order in ("BG", "GB", "RG", "GR")),
        *(cv2.cvtColor(grey[:300, :402].copy(), getattr(cv2, f"COLOR_YUV2BGR_{kind}")) for kind in ("NV12", "NV21")),
        *(cv2.cvtColor(colour[:300, :402, :2].copy(), getattr(cv2, f"COLOR_YUV2BGR_{kind}")) for kind in ("UYVY", "YUY2")),
        cv2.cvtColor(colour, cv2.COLOR_BGR2RGB), cv2.cvtColor(bgra, cv2.COLOR_BGRA2BGR),
        cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY), cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR),
    ],
    "distanceTransform": [cv2.distanceTransform((grey > 3).astype(np.uint8), cv2.DIST_L2, 3)],
    "fillConvexPoly": drawn(cv2.fillConvexPoly, cv2.convexHull(corners), (9, 200, 31), cv2.LINE_AA, 4),
    "fillPoly": drawn(cv2.fillPoly, [corners], (9, 200, 31), cv2.LINE_AA, 4),
    "getTextSize": [np.array(cv2.getTextSize("Wagon 12.5 m", cv2.FONT_HERSHEY_SIMPLEX, 0.7, 1)[0])],
    "imdecode": [cv2.imdecode(one, cv2.IMREAD_COLOR) for one in (jpeg, png)],
    "imencode": [
        jpeg, png, cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, 90])[1],
        cv2.imencode(".png", wide, [cv2.IMWRITE_PNG_COMPRESSION, 3])[1],
    ],
    "inRange": [cv2.inRange(xy, (0, 0, 0, 0), (400, 299, 0, 0))],
    "line": drawn(cv2.line, (3, 5), (380, 211), (0, 255, 80), 2, cv2.LINE_AA),
    "polylines": drawn(cv2.polylines, [corners], True, (200, 40, 0), 2, cv2.LINE_AA, 4),
    "putText": drawn(cv2.putText, "Wagon 12.5 m", (9, 99), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (9, 9, 9), 1, cv2.LINE_AA),
    "rectangle": drawn(cv2.rectangle, (5, 6), (300, 200), (1, 2, 3), -1),
    "remap": [cv2.remap(one, xy, fraction, cv2.INTER_LINEAR) for one in (grey, colour, bgra, wide.astype(np.float64))],
    "resize": [
        *(cv2.resize(colour, size, interpolation=cv2.INTER_LINEAR)
          for size in ((201, 150), (133, 99), (97, 61), (640, 480), (400, 300))),
        *(cv2.resize(colour[: 300 // by * by, : 400 // by * by], (400 // by, 300 // by), interpolation=cv2.INTER_AREA)
          for by in range(2, 7)),
    ],
}
if len(sys.argv) > 1:
    cv2.imwrite(sys.argv[1], colour)
    made["imread"] = [cv2.imread(sys.argv[1])]
digest = lambda arrays: hashlib.sha256(b"".join(np.ascontiguousarray(one).tobytes() for one in arrays)).hexdigest()
json.dump({name: digest(arrays) for name, arrays in made.items()}, sys.stdout)
"""
# They look at the machine, or set it up.
OTHER = {"getCPUFeaturesLine", "setNumThreads"}


def called():
    """The functions of OpenCV that the package calls; the sample world may use any."""
    names = set()
    for module in PACKAGE.rglob("*.py"):
        if module.is_relative_to(PACKAGE / "sample"):
            continue
        for node in ast.walk(ast.parse(module.read_text("utf-8"))):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and ast.unparse(node.func.value) == "cv2"
            ):
                names.add(node.func.attr)
    return names - OTHER


def digests(file, environment):
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(file)],
        env=os.environ | environment,
        capture_output=True,
        check=True,
    )
    return json.loads(done.stdout)


def test_an_older_processor_gives_the_same(tmp_path):
    new, old = digests(tmp_path / "new.png", {}), digests(tmp_path / "old.png", OLD_PROCESSOR)
    assert [name for name in new if new[name] != old[name]] == []
    assert called() <= set(new)

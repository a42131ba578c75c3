"""The newest lerobot, tried by hand: its result is that of the writers as they are."""

import json
from datetime import date

from scripts import newest_lerobot
from scripts.newest_lerobot import RESULT, writers_fingerprint

AGAIN = "LeRobot's writers changed since the newest lerobot was tried: run `python -m scripts.newest_lerobot`, commit its result"


def test_the_newest_lerobot_was_tried_with_these_writers():
    result = json.loads(RESULT.read_text(encoding="utf-8"))
    assert result["writers"] == writers_fingerprint(), AGAIN
    assert set(result["tests"].values()) == {"passed"}
    assert len(result["tests"]) >= 5
    assert tuple(map(int, result["python"].split(".")[:2])) >= (3, 12)
    assert date.fromisoformat(result["date"])


def test_the_fingerprint_is_that_of_the_code(tmp_path, monkeypatch):
    folder = tmp_path / "bagassets" / "formats" / "lerobot"
    folder.mkdir(parents=True)
    monkeypatch.setattr(newest_lerobot, "ROOT", tmp_path)

    def fingerprint(text):
        for name in newest_lerobot._WRITERS:
            (folder / f"{name}.py").write_text(text)
        return writers_fingerprint()

    plain = fingerprint('"""It writes."""\n\nimport av\n\nCRF = 23\n')
    assert fingerprint('"""It writes well."""\nimport json\n# Why.\nCRF = 23\n') == plain
    assert fingerprint('"""It writes."""\n\nimport av\n\nCRF = 24\n') != plain

"""Running one action: whatever is made, of a recording or of a whole dataset, is made by `run_action`.

The exceptions are `engine.execute.run_pass`, which makes several channels at once from one pass over a recording, and
`engine.first_pass`, which makes an inventory before its action is known. The store itself runs nothing: it looks results
up, puts them in place and records them.
"""

from collections.abc import Callable
from pathlib import Path

from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonObject
from bagassets.store.action import Action
from bagassets.store.artifact import ArtifactWriter
from bagassets.store.store import Outcome, Store

Make = Callable[[ArtifactWriter], JsonObject]


def run_action(store: Store, action: Action, make: Make, subject: Path | None = None) -> Outcome:
    """Return the known outcome of `action`, or run `make`, which writes the artifact and returns its summary.

    If another process is running the same action, wait for its outcome. An error of `make` is recorded under the
    action's digest and raised again, unless the action is not to blame: a full disk, a recording that changed
    meanwhile.

    Args:
        store: where the artifact is made.
        action: the action.
        make: writes the artifact.
        subject: the recording that errors may name; see `Store.record_failure`.
    """
    with store.lock(action):
        known = store.use(action)
        if known is not None:
            return known
        pending = store.begin(action)
        try:
            summary = make(pending.out)
        except BaseException as err:
            pending.discard()
            if isinstance(err, BagAssetsError) and not err.transient:
                store.record_failure(action, str(err), subject)
            raise
        return pending.commit(summary)

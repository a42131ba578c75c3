"""The report that is written with the dataset: what the link on its page in the web UI opens."""

from dataclasses import replace

import dagster as dg

from bagassets.defs.artifact_files import page_link
from bagassets.defs.check_records import findings_on_record
from bagassets.defs.instance_plan import InstancePlan
from bagassets.defs.workspace import Workspace
from bagassets.errors import BagAssetsError
from bagassets.escaping import markdown
from bagassets.formats.report_data import report_data, report_path
from bagassets.report.page import report_page
from bagassets.report.write import write_page

__all__ = ["MOST_RECORDINGS", "write_report"]

MOST_RECORDINGS = 1000
"""It takes a millisecond or two for each recording, and a change of one is not to cost more the more there are."""


def write_report(
    instance: dg.DagsterInstance, workspace: Workspace, planned: InstancePlan
) -> dg.MarkdownMetadataValue:
    """Write the report with what the checks of recordings found when they ran; return a link to it, or why there is none."""
    if len(planned.plan.bags) > MOST_RECORDINGS:
        return dg.MetadataValue.md(f"`bagassets report` writes it (more than {MOST_RECORDINGS} recordings)")
    try:
        data = report_data(workspace.recipe, workspace.store, planned.plan)
        found = findings_on_record(instance, workspace)
        recordings = []
        for recording in data.recordings:
            problems, passed = found.get(recording.key, ((), 0))
            recordings.append(replace(recording, problems=problems, checks_passed=passed))
        write_page(report_path(workspace.recipe), report_page(replace(data, recordings=recordings)))
    except (BagAssetsError, OSError) as err:  # the dataset is as good without it
        return dg.MetadataValue.md(f"It could not be written: {markdown(str(err))}")
    return dg.MetadataValue.md(f"[Open the report]({page_link('report')})")

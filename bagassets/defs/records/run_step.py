"""The step of a run, as far as those need it who make and record something for it: in its worker, or in a process beside it."""

import logging
from dataclasses import dataclass
from typing import Self

import dagster as dg


@dataclass(frozen=True)
class RunStep:
    """The step of a run that makes recordings or datasets; with an instance alone, it stands for no run.

    Attributes:
        instance: has the run.
        run_id: the run.
        job_name: of the run.
        step: the step's key.
        is_planned: Dagster has recorded of each asset of each recording that the run is to make it.
        logger: of the step, in its worker.
    """

    instance: dg.DagsterInstance
    run_id: str = ""
    job_name: str = ""
    step: str | None = None
    is_planned: bool = False
    logger: logging.Logger | None = None

    @classmethod
    def of(
        cls, context: dg.AssetExecutionContext | dg.OpExecutionContext, *, is_planned: bool = False
    ) -> Self:
        """Return the step that has a context."""
        step = context.op_execution_context.op.name
        return cls(context.instance, context.run.run_id, context.job_name, step, is_planned, context.log)

    def log(self, message: str, level: int = logging.INFO) -> None:
        """Say something in the log of the run."""
        if self.logger is not None:
            self.logger.log(level, message)
        else:
            self.instance.report_engine_event(message, run_id=self.run_id, job_name=self.job_name)

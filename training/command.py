"""The command line of the jobs that train: parse, train or go on, print."""

import argparse
import dataclasses
import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any

from cspace.errors import CspaceError, InputError
from services.commands import report_error, report_result
from training.config import JobConfig
from training.config_section import described

# The exit code of a job that was asked to stop.
STOPPED = 3


@dataclass(frozen=True, slots=True)
class JobCommand:
    """What tells one job's command from another's."""

    description: str
    example: str
    config: type[JobConfig]
    run: str  # module:function, imported for the job alone

    @property
    def program(self) -> str:
        """Its name in messages."""
        return self.config.SCRIPT.removesuffix(".py")

    def main(self, arguments: Sequence[str] | None = None) -> int:
        """Parse, train, print; returns the exit code."""
        line = self._parser()
        options = line.parse_args(arguments)
        if options.resume and (options.overrides or options.job):
            line.error("--resume goes on with the job's own configuration and takes neither --set nor --job")
        logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stdout)
        logging.getLogger("training").setLevel(logging.INFO)
        try:
            config = self.config.load(options.preset, options.overrides)
            if options.print_config:
                print("\n".join(described(config)))
                return 0
            job = self._job(config, options)
            result = resolve_name(self.run)(job)
        except CspaceError as error:
            return report_error(error, InputError, program=self.program)
        except KeyboardInterrupt:
            again = "submit it again" if options.job else "go on with --resume and the run's id"
            print(f"{self.program}: stopped; nothing is lost: {again}", file=sys.stderr)
            return STOPPED
        report_result(dataclasses.asdict(result), result.rows(job.folder), job.folder)
        return 0

    def _job(self, config: JobConfig, options: argparse.Namespace) -> Any:
        """The job that is to be run: a new one, or one that goes on."""
        from training.jobs.job import Job, job_environment  # noqa: PLC0415
        from training.jobs.launch import connect  # noqa: PLC0415
        from training.jobs.provenance import job_tags  # noqa: PLC0415

        environment = job_environment()
        connect()
        if options.resume:
            return Job.resume(options.resume, environment, self.config)
        tags = job_tags(config.preset, config.seed, f"training/{config.SCRIPT}")
        return Job.start(config, environment, tags, self.program.replace("_", "-"), options.job)

    def _parser(self) -> argparse.ArgumentParser:
        parser = argparse.ArgumentParser(
            description=self.description,
            epilog="Reads MLFLOW_TRACKING_URI, CSPACE_DATA_DIR. "
            "Exit codes: 0 registered, 1 failed, 2 bad input, 3 stopped and can go on.",
        )
        preset = self.config.model_fields["preset"].default
        parser.add_argument("--preset", default=preset, help=f"one of {', '.join(self.config.presets())}")
        parser.add_argument(
            "--set",
            dest="overrides",
            metavar="KEY=VALUE",
            action="append",
            default=[],
            help=f"such as {self.example}",
        )
        parser.add_argument(
            "--job", metavar="NAME", help="the job's name: submitted again under it, the job goes on"
        )
        parser.add_argument(
            "--resume", metavar="RUN_ID", help="go on with a stopped job, by its own configuration"
        )
        parser.add_argument(
            "--print-config", action="store_true", help="print all keys with their values, and end"
        )
        return parser

"""The table at the end of the main job."""

from collections.abc import Sequence
from pathlib import Path

from services.evaluator.measures.reconstruction import SamplerSummary
from services.evaluator.statistics import Interval
from services.local.quickstart.quality import SAMPLES, SCENARIOS, ServedQuality
from services.local.quickstart.results import EvaluationResult, TrainingResult
from services.local.texts import aligned


def summary(
    training: TrainingResult,
    evaluation: EvaluationResult,
    quality: ServedQuality,
    pictures: Sequence[Path],
    elapsed_s: float,
) -> str:
    """What the main job did and how good its version is."""
    verdict = "champion now" if evaluation.promoted else "not promoted, the champion stays"
    head = aligned(
        [
            ("version", f"{training.reference}, {verdict}"),
            ("run", training.run_id),
            ("digest", training.digest),
            ("time", f"{elapsed_s:.0f} s"),
        ]
    )
    reasons = "\n".join(f"  {reason}" for reason in evaluation.reasons)
    drawn = "\n".join(f"  {path}" for path in pictures)
    return (
        f"{head}\nwhy\n{reasons}\n\n"
        f"{SCENARIOS} unseen scenarios over HTTP, {SAMPLES} samples each, "
        f"no validity filter; 95 % intervals over scenarios\n{quality_table(quality)}\n\npictures\n{drawn}"
    )


def quality_table(quality: ServedQuality) -> str:
    """Precision, coverage and energy ratio of the version beside uniform and real samples."""
    rows: list[tuple[str, ...]] = [("sampler", "precision", "coverage", "EDr")]
    named = {
        quality.reference: quality.summary.sampler,
        "uniform": quality.summary.uniform,
        "real samples": quality.summary.real,
    }
    rows += [(name, *_cells(one)) for name, one in named.items()]
    return aligned(rows)


def _cells(one: SamplerSummary) -> tuple[str, str, str]:
    return (_text(one.precision), _text(one.coverage), _text(one.edr))


def _text(interval: Interval) -> str:
    return f"{interval.estimate:.3f} [{interval.low:.3f}, {interval.high:.3f}]"

"""The table at the end of the main job."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from services.evaluator.measures.reconstruction import ReconstructionSummary, SamplerSummary
from services.evaluator.statistics import Interval
from services.local.quickstart.quality import SAMPLES
from services.local.quickstart.results import EvaluationResult, TrainingResult
from services.local.texts import aligned
from services.registry.references import is_shipped


def summary(
    training: TrainingResult,
    evaluation: EvaluationResult,
    quality: Mapping[str, ReconstructionSummary],
    scenarios: int,
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
        f"{scenarios} unseen scenarios over HTTP, {SAMPLES} samples each, "
        f"drawn without the validity filter and as served; 95 % intervals over scenarios\n"
        f"{quality_table(quality)}\n\npictures\n{drawn}"
    )


def quality_table(quality: Mapping[str, ReconstructionSummary]) -> str:
    """Precision, coverage and energy ratio of models by reference, beside uniform and real samples."""
    rows: list[tuple[str, ...]] = [("sampler", "precision", "coverage", "EDr")]
    for reference, summary in quality.items():
        name = f"{reference} (shipped)" if is_shipped(reference) else reference
        rows.append((name, *_cells(summary.sampler)))
        if summary.confident is not None:
            rows.append((f"{name}, as served", *_cells(summary.confident)))
    any_of_them = next(iter(quality.values()))
    rows += [("uniform", *_cells(any_of_them.uniform)), ("real samples", *_cells(any_of_them.real))]
    return aligned(rows)


def _cells(one: SamplerSummary) -> tuple[str, str, str]:
    return (_text(one.precision), _text(one.coverage), _text(one.edr))


def _text(interval: Interval) -> str:
    return f"{interval.estimate:.3f} [{interval.low:.3f}, {interval.high:.3f}]"

"""Pictures of a training: how the losses went."""

from collections.abc import Mapping, Sequence

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

History = Sequence[Mapping[str, float]]

# Trials that have a picture of their own.
PANELS = {
    "vae": ("reconstruction_loss", "kl"),
    "validity": ("validity_loss", "validity_accuracy"),
    "gate": ("gate_divergence",),
}
_WGAN_PANELS = ("wasserstein_estimate", "gradient_penalty", "generator_loss")
_NO_LOSSES = ("step", "time_ms", "steps_per_s")
_LOGARITHMIC = ("reconstruction_loss", "validity_loss", "gate_divergence")
_LABELS = {
    "wasserstein_estimate": "Wasserstein estimate",
    "gradient_penalty": "gradient penalty",
    "generator_loss": "generator loss",
    "reconstruction_loss": "reconstruction loss",
    "validity_loss": "cross entropy [nat]",
    "validity_accuracy": "accuracy in the batch",
    "kl": "KL divergence [nat]",
    "gate_divergence": "divergence from the true shares [nat]",
}


def wgan_curves(histories: Mapping[str, History]) -> Figure:
    """The losses of the trials of a model family over their steps, one line a trial."""
    rows = [history[0] for history in histories.values()]
    known = [name for name in _WGAN_PANELS if any(name in row for row in rows)]
    return _curves(histories, known or [name for name in rows[0] if name not in _NO_LOSSES], "generator step")


def own_curves(trial: str, history: History) -> Figure:
    """What a trial of ``PANELS`` minimises over its steps."""
    return _curves({trial: history}, PANELS[trial], "step")


def path_curves(histories: Mapping[str, History]) -> Figure:
    """The Wasserstein estimate of the path model over its steps."""
    return _curves(histories, ["wasserstein_estimate"], "step")


def _curves(histories: Mapping[str, History], names: Sequence[str], x_label: str) -> Figure:
    figure = Figure(figsize=(4.2 * len(names), 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, name in zip(figure.subplots(1, len(names), squeeze=False)[0], names, strict=True):
        for trial, history in histories.items():
            if name not in history[0]:
                continue
            axes.plot(
                [row["step"] for row in history], [row[name] for row in history], label=trial, linewidth=1.2
            )
        axes.set_xlabel(x_label)
        axes.set_title(_LABELS.get(name, name), fontsize=10)
        axes.grid(visible=True, alpha=0.3)
        if name in _LOGARITHMIC:
            axes.set_yscale("log")
        if len(histories) > 1 and len(names) > 1 and not all(name in rows[0] for rows in histories.values()):
            axes.legend(fontsize=8)
    if len(histories) > 1:
        handles, labels = axes.get_legend_handles_labels()
        if len(labels) == len(histories):
            figure.legend(handles, labels, loc="outside lower center", ncols=len(histories))
    return figure

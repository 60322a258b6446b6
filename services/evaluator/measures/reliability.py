"""Whether a validity head's confidence means what it says, as a picture."""

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from services.evaluator.measures.occupancy import OccupancySummary


def reliability_diagram(head: OccupancySummary, title: str) -> Figure:
    """Free share over mean confidence by bin, with how many configurations each bin holds below it."""
    figure = Figure(figsize=(4.6, 5.4), layout="constrained")
    FigureCanvasAgg(figure)
    shares, sizes = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    confidence, free, counts = zip(*head.reliability, strict=True)
    shares.plot([0.0, 1.0], [0.0, 1.0], color="#999999", linewidth=1.0, label="calibrated")
    shares.plot(confidence, free, marker="o", markersize=4, linewidth=1.2, label="validity head")
    shares.set(ylabel="free share", xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    shares.set_title(f"{title}\nexpected calibration error {head.calibration_error:.4f}", fontsize=9)
    shares.legend(loc="upper left", fontsize=8)
    sizes.bar(confidence, counts, width=0.05)
    sizes.set(xlabel="confidence", ylabel="configurations", yscale="log")
    return figure

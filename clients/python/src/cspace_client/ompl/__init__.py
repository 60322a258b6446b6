"""Learned samples for OMPL's planners: a problem and a checker of one's own, or a whole set-up of one's own.

It needs OMPL's Python package; nothing else of ``cspace_client`` does.
"""

from cspace_client.ompl.learned_sampler import (
    LearnedSampler,
    Problem,
    Solution,
    feed_samples,
    learned_sampler,
)

__all__ = ["LearnedSampler", "Problem", "Solution", "feed_samples", "learned_sampler"]

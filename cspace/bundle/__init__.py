"""The deployable artefact: a folder of ONNX graphs with their description, sums and golden case."""

from cspace.bundle.files import GoldenCase
from cspace.bundle.load import Bundle, graphs_of, load_verified, write_bundle
from cspace.bundle.sampling import Picture, SampleSet
from cspace.bundle.spec import SCHEMA_VERSION, BundleSpec, Provenance, RandomInput

__all__ = [
    "SCHEMA_VERSION",
    "Bundle",
    "BundleSpec",
    "GoldenCase",
    "Picture",
    "Provenance",
    "RandomInput",
    "SampleSet",
    "graphs_of",
    "load_verified",
    "write_bundle",
]

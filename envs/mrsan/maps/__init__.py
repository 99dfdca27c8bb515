"""Maps of static obstacles from files."""

from mrsan.kernels.walls import MOST_SEGMENTS
from mrsan.maps.load import MapFile, load_map, read_map
from mrsan.maps.polygons import MapError, Polygon
from mrsan.maps.ros import trace_free_area

__all__ = [
    "MOST_SEGMENTS",
    "MapError",
    "MapFile",
    "Polygon",
    "load_map",
    "read_map",
    "trace_free_area",
]

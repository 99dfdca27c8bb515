"""Maps of static obstacles from files."""

from mrsan.maps.load import MAX_SEGMENTS, load_map
from mrsan.maps.polygons import MapError, Polygon

__all__ = ["MAX_SEGMENTS", "MapError", "Polygon", "load_map"]

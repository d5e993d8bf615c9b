"""Maps made by others, and the junctions that are cut out of them.

``importing`` is the door: it reads map files, lists and chooses junctions, cuts one out
and decides where sensors can be mounted. Each format has a reader that returns a
``source_map.SourceMap``: ``opendrive/`` and ``openstreetmap/`` read roads;
``gis_files``, ``city_models``, ``mesh_files`` and ``point_clouds`` read what stands
next to them. ``cut`` takes the surroundings of a junction into a local frame
(``georeferences``), ``sites`` and ``place_lists`` decide on the places for sensors.
"""

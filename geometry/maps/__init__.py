"""Maps that others made, and the junctions that are cut out of them.

``map_files`` knows all readers; each turns one file into one ``model.SourceMap``: ``opendrive/``
and ``openstreetmap/`` have roads, ``footprint_files``, ``city_json``, ``city_gml``, ``mesh_files``
and ``point_clouds`` what stands beside them. ``survey`` lists junctions, ``cut`` takes what lies
around one into its own ``local_frame``, ``site_choice`` decides where sensors may hang;
``importing`` does all of it.
"""

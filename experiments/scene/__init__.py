"""``place-rsus scene``: a program that makes scenes of maps, shows and checks them."""

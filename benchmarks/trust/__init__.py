"""How far a record and a model are to be trusted, measured."""

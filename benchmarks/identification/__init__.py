"""This project's identification beside other projects', on the same records, scored alike, in one run."""

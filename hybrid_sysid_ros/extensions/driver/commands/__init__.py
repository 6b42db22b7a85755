"""Commands of this extension, one file each."""

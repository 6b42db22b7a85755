"""Fuzzy models: Takagi-Sugeno and fuzzy-neural (DIFNN) structures, and their rules as blocks of hybrids."""

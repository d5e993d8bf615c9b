"""Covering problems (LSCP and MCLP) read from files, solved and proven."""

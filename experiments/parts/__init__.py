"""Parts of an answer: each file has one part's value, words, table, figure and section."""

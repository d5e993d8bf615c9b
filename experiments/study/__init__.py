"""The CarlaNCAP study: its layout of 12 cameras, its published figures, and ours beside them."""

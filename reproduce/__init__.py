"""The paper's tables, figures and claims, computed anew and set beside the printed ones."""

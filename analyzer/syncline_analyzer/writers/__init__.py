"""Writers of captures and of other tools' log formats."""

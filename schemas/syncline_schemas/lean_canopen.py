"""python-canopen's object dictionaries, without what python-can needs for MDF 4 files only.

python-canopen imports python-can, and that asammdf where it is installed, with pandas and sympy
behind it: two seconds and 150 MB for whoever reads an EDS.
"""

from syncline_schemas.hidden_module import hidden

with hidden("asammdf"):
    from canopen.objectdictionary import ObjectDictionary, ODVariable
    from canopen.objectdictionary.eds import import_eds

__all__ = ["ODVariable", "ObjectDictionary", "import_eds"]

"""The vocabulary of CiA 301: services, NMT, EMCY, SDO abort codes, data types."""

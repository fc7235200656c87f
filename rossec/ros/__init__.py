"""The ROS wire: TCPROS headers and frames, XML-RPC over HTTP, names, settings. Sans-IO."""

<?xml version="1.0" encoding="UTF-8"?>
<!-- The names of the thesis (figure A.3, appendix A.2). $type is node, topic or service, and $name is
     the topic's or service's name in the metadata. What differs from the print: docs/spec/namespace.md. -->
<xsl:stylesheet version="1.0"
  xmlns:xsl="http://www.w3.org/1999/XSL/Transform">
  <xsl:output method="xml" indent="no"/>
  <xsl:strip-space elements="*"/>
  <xsl:param name="type"/>
  <xsl:param name="name"/>
  <parameter name="node-owner" path="/node/owner" default=""/>
  <parameter name="node-group" path="/node/group" default="unknown-group"/>
  <parameter name="node-name" path="/node/name" default="unknown-node"/>

  <xsl:template match="/">
    <xsl:if test="$type='topic'">
      <xsl:apply-templates select="node/topic"/>
    </xsl:if>
    <xsl:if test="$type='service'">
      <xsl:apply-templates select="node/service"/>
    </xsl:if>
    <xsl:if test="$type='node'">
      <xsl:apply-templates select="node"/>
    </xsl:if>
  </xsl:template>

  <xsl:template match="/node">
    <name>
      <!-- node/group: to what kind of devices does this node belong? -->
      <xsl:text>/</xsl:text><xsl:value-of select="$node-group"/>
      <xsl:if test="$node-owner!=''">
        <!-- node/owner: who owns this device? -->
        <xsl:text>/</xsl:text><xsl:value-of select="$node-owner"/>
      </xsl:if>
      <!-- node/name: what is the name of the device? -->
      <xsl:text>/</xsl:text><xsl:value-of select="$node-name"/>
    </name>
  </xsl:template>

  <xsl:template match="/node/topic | /node/service">
    <parameter name="location" default="unknown-location"/>
    <parameter name="function" default=""/>
    <parameter name="mobile" default="false"/>

    <xsl:if test="normalize-space(name)=$name">
      <name>
        <xsl:choose>
          <!-- a mobile topic lies where its node lies -->
          <xsl:when test="$mobile='true'">
            <xsl:text>/</xsl:text><xsl:value-of select="$node-group"/>
            <xsl:if test="$node-owner!=''">
              <xsl:text>/</xsl:text><xsl:value-of select="$node-owner"/>
            </xsl:if>
            <xsl:text>/</xsl:text><xsl:value-of select="$node-name"/>
          </xsl:when>
          <!-- topic/location: a stationary one lies where it is -->
          <xsl:otherwise>
            <xsl:text>/</xsl:text><xsl:value-of select="$location"/>
          </xsl:otherwise>
        </xsl:choose>

        <!-- topic/function: does it belong to a general kind of device? -->
        <xsl:if test="$function!=''">
          <xsl:text>/</xsl:text><xsl:value-of select="$function"/><xsl:text>s</xsl:text>
        </xsl:if>

        <xsl:text>/</xsl:text><xsl:value-of select="$name"/>
      </name>
    </xsl:if>
  </xsl:template>
</xsl:stylesheet>

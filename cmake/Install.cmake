# What find_package(fastcollide) needs: headers, library, package description. The wheel takes the component `python`
# alone.
include(CMakePackageConfigHelpers)

set(package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/fastcollide)
install(DIRECTORY include/fastcollide DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} COMPONENT cpp)
install(TARGETS fastcollide EXPORT fastcollide ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT cpp)
install(EXPORT fastcollide NAMESPACE fastcollide:: FILE fastcollideTargets.cmake DESTINATION ${package_dir} COMPONENT cpp)

configure_package_config_file(cmake/fastcollideConfig.cmake.in fastcollideConfig.cmake INSTALL_DESTINATION ${package_dir})
write_basic_package_version_file(fastcollideConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(
  FILES ${PROJECT_BINARY_DIR}/fastcollideConfig.cmake ${PROJECT_BINARY_DIR}/fastcollideConfigVersion.cmake
  DESTINATION ${package_dir} COMPONENT cpp)
